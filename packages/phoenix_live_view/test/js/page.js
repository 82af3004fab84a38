// What a page loads in a browser; there is no bundler.
import { Socket } from "/js/phoenix.mjs";
import { LiveSocket } from "/js/live_view.js";

const heard = (window.heard = []);
const Echo = {
  mounted() {
    window.hook = this;
    this.handleEvent("mounted", (payload) => heard.push(payload));
  },
};
sessionStorage.setItem("phx:live-socket:debug", "false");
const _csrf_token = document.querySelector("meta[name=csrf-token]").content;
window.liveSocket = new LiveSocket("/live", Socket, { params: { _csrf_token }, hooks: { Echo }, rejoinAfterMs: () => 10 });
window.liveSocket.connect();
