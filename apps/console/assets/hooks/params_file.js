// Files of parameters: one is opened and sent as text, one is written by the server and saved.
import { chosen, save } from "../lib/files.js";

export default {
  mounted() {
    this.el.addEventListener("change", async (event) => {
      if (event.target.type !== "file") return;
      const file = await chosen(event.target);
      if (file) this.pushEvent("open_file", file);
    });
    this.handleEvent("params:file", ({ name, text }) => save(name, text));
  },
};
