// Selects vehicles in the table: a click one, with Ctrl one more, with Shift a range; the same with arrows and Space. Tells the page when a hand
// is on the table, by pointer or focus, so that its rows keep their places.
const AWAY_MS = 500;
// What was selected when the gateway went away, for the page that may be loaded again because of it.
const KEPT = "aerie:selected";
const loadedAgain = () => performance.getEntriesByType("navigation")[0]?.type === "reload";

export default {
  mounted() {
    this.el.addEventListener("click", (event) => this.click(event));
    this.el.addEventListener("keydown", (event) => this.key(event));
    this.el.addEventListener("pointerenter", () => { this.over = true; this.hand(); });
    this.el.addEventListener("pointerleave", () => { this.over = false; this.hand(); });
    for (const name of ["focusin", "focusout"]) this.el.addEventListener(name, () => setTimeout(() => this.hand()));
    this.digits = (event) => this.digit(event);
    window.addEventListener("keydown", this.digits);
    this.again(loadedAgain());
  },

  destroyed() {
    this.gone = true;
    window.removeEventListener("keydown", this.digits);
    clearTimeout(this.away);
  },

  // A server that comes back does not know what was selected.
  disconnected() {
    const selected = [...this.el.querySelectorAll("tbody tr[aria-selected=true]")].map((row) => row.dataset.id);
    if (selected.length > 0) sessionStorage.setItem(KEPT, JSON.stringify(selected));
  },

  reconnected() {
    this.again(true);
    if (this.told) this.tell(true);
  },

  again(wanted) {
    const kept = sessionStorage.getItem(KEPT);
    sessionStorage.removeItem(KEPT);
    if (kept && wanted) this.pushEvent("again", { ids: JSON.parse(kept) });
  },

  // A hand that leaves may come back at once.
  hand() {
    clearTimeout(this.away);
    const on = !this.gone && (this.over || this.el.contains(document.activeElement));
    if (on && !this.told) this.tell(true);
    if (!on && this.told) this.away = setTimeout(() => this.tell(false), AWAY_MS);
  },

  // With the places that the operator sees: the page may have sorted the rows meanwhile.
  tell(over) {
    this.told = over;
    const ids = over ? this.rows().map((row) => row.dataset.id) : [];
    // A page that is being left needs no answer: with a callback, what could not be sent is not an error.
    this.pushEvent("pointer", { over, ids }, () => {});
  },

  rows() {
    return [...this.el.querySelectorAll("tbody tr")];
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

  // The keys 1 to 9 press the chips that show them.
  digit({ key, target, repeat, ctrlKey, metaKey, altKey }) {
    if (!/^[1-9]$/.test(key) || repeat || ctrlKey || metaKey || altKey) return;
    if (target.closest?.("input:not([type=checkbox]), select, textarea") || document.querySelector("dialog[open]")) return;
    document.querySelector(`.fleet-groups [data-digit="${key}"]`)?.click();
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
    const rows = this.rows();
    const to = rows[Math.min(rows.length - 1, Math.max(0, rows.indexOf(row) + step))];
    to.focus();
    to.scrollIntoView({ block: "nearest" });
    if (extend) this.select(to, "range");
  },

  select(row, how) {
    this.pushEvent("select", { id: row.dataset.id, how });
  },
};
