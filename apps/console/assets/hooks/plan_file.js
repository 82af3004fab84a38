// Files of plans: opened here and sent as text, written by the server and saved here. The draft is kept in this tab too, so that a
// reload or a gateway that starts again does not lose it.
import { chosen, save } from "../lib/files.js";

export const KEY = "plan";
const ZONE = "plan-zone"; // the corners of one that is not closed yet

export default {
  mounted() {
    this.el.addEventListener("change", (event) => event.target.id === "plan-import" && this.open(event.target));
    this.handleEvent("plan:keep", ({ text, zone }) => {
      sessionStorage.setItem(KEY, text);
      sessionStorage.setItem(ZONE, JSON.stringify(zone));
    });
    this.handleEvent("plan:file", ({ name, text }) => save(name, text));
    this.restore();
  },

  reconnected() {
    this.restore();
  },

  restore() {
    const text = sessionStorage.getItem(KEY);
    if (text) this.pushEvent("restore", { text, ...JSON.parse(sessionStorage.getItem(ZONE)) });
  },

  async open(input) {
    const file = await chosen(input);
    if (file) this.pushEvent("import", file);
  },
};
