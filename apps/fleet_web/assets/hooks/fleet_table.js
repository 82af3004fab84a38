// Selects vehicles in the table: a click one, with Ctrl one more, with Shift a range; the same with arrows and Space.
export default {
  mounted() {
    this.el.addEventListener("click", (event) => this.click(event));
    this.el.addEventListener("keydown", (event) => this.key(event));
  },

  // A server that comes back does not know what was selected.
  disconnected() {
    this.kept = [...this.el.querySelectorAll("tbody tr[aria-selected=true]")].map((row) => row.dataset.id);
  },

  reconnected() {
    if (this.kept?.length) this.pushEvent("again", { ids: this.kept });
  },

  click(event) {
    const row = event.target.closest("tbody tr");
    if (!row || event.target.closest("a, button")) return;
    const box = event.target.closest("input[type=checkbox]");
    const how = event.shiftKey ? "range" : box || event.ctrlKey || event.metaKey ? "toggle" : "only";
    // Text is not marked by a range.
    if (event.shiftKey) getSelection()?.removeAllRanges();
    row.focus({ preventScroll: true });
    this.select(row, how);
  },

  key(event) {
    const row = event.target.closest("tbody tr");
    if (!row || event.target !== row) return;
    const step = { ArrowDown: 1, ArrowUp: -1, PageDown: 10, PageUp: -10, Home: -Infinity, End: Infinity }[event.key];
    if (step) this.move(row, step, event.shiftKey);
    else if (event.key === " ") this.select(row, event.shiftKey ? "range" : "toggle");
    else if (event.key === "Enter") row.querySelector("a")?.click();
    else if (event.key === "Escape") this.pushEvent("none", {});
    else if (event.key.toLowerCase() === "a" && (event.ctrlKey || event.metaKey)) this.pushEvent("all", {});
    else return;
    event.preventDefault();
    event.stopPropagation();
  },

  move(row, step, extend) {
    const rows = [...row.parentElement.children];
    const to = rows[Math.min(rows.length - 1, Math.max(0, rows.indexOf(row) + step))];
    to.focus();
    to.scrollIntoView({ block: "nearest" });
    if (extend) this.select(to, "range");
  },

  select(row, how) {
    this.pushEvent("select", { id: row.dataset.id, how });
  },
};
