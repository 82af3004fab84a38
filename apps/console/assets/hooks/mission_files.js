// Files for the missions of several vehicles, in parts that one frame takes, or the draft that the page Plan keeps in this tab.
import { allChosen } from "../lib/files.js";
import { KEY } from "./plan_file.js";

export default {
  mounted() {
    this.el.addEventListener("change", (event) => event.target.id === "mission-file" && this.open(event.target));
    this.el.addEventListener("click", (event) => event.target.closest("[data-draft]") && this.draft());
  },

  async open(input) {
    for (const part of await allChosen(input)) this.pushEvent("sheet_files", part);
  },

  draft() {
    const text = sessionStorage.getItem(KEY);
    this.pushEvent("sheet_files", text ? { files: [{ name: "Draft of Plan", text }] } : { error: "This tab has no draft: draw one on the page Plan." });
  },
};
