// The order of a sheet's lines by hand: a line that is dropped on another one takes its place. The buttons of each line do the same.
export default {
  mounted() {
    this.el.addEventListener("dragstart", (event) => {
      this.id = event.target.closest("li")?.dataset.id;
      event.dataTransfer.effectAllowed = "move";
      event.dataTransfer.setData("text/plain", this.id ?? "");
    });
    this.el.addEventListener("dragover", (event) => { if (this.id) event.preventDefault(); });
    this.el.addEventListener("drop", (event) => {
      event.preventDefault();
      const to = event.target.closest("li")?.dataset.id;
      if (this.id && to && to !== this.id) this.pushEvent("sheet_move", { id: this.id, to });
      this.id = undefined;
    });
    this.el.addEventListener("dragend", () => { this.id = undefined; });
  },
};
