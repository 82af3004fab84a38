// The form of a command. Its button makes the command's id, one for each press: nothing but a press sends it, and the same press is never
// sent again. A form with a button that is to be held is not sent by Enter.
import { commandId } from "../lib/command_id.js";
import { shown } from "../lib/shown.js";

export default {
  mounted() {
    this.el.addEventListener("submit", (event) => {
      event.preventDefault();
      event.stopPropagation();
      const hold = this.el.querySelector(".hold");
      if (hold) return hold.focus();
      if (document.documentElement.classList.contains("gateway-lost")) return;
      this.pushEvent("command", { id: commandId(), type: this.el.dataset.type, ...shown(this.el) });
    });
  },
};
