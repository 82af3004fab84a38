// A button that does something only after it was held for `data-hold` milliseconds, by pointer, Space or Enter, or by the key of
// `data-shortcut` wherever the focus is.
import { commandId } from "../lib/command_id.js";

const lost = () => document.documentElement.classList.contains("gateway-lost");
const TREMBLE_PX = 8;
const typing = (target) => target.closest?.("input, select, textarea, [contenteditable]");

export default {
  mounted() {
    const { el } = this;
    this.listen(el, "pointerdown", (event) => { if (event.button === 0) this.grab(event); });
    this.listen(el, "pointermove", (event) => this.moved(event));
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) this.listen(el, name, () => this.end("pointer"));
    this.listen(el, "contextmenu", (event) => event.preventDefault());
    this.listen(el, "blur", () => this.end());
    this.listen(el, "keydown", (event) => this.press(event, ["Enter", " "]));
    this.listen(window, "keydown", (event) => this.shortcut(event));
    this.listen(window, "keyup", (event) => this.end(event.key));
    this.listen(window, "blur", () => this.end());
    this.listen(window, "gateway", () => this.end());
  },
  updated() { if (this.el.disabled) this.end(); },
  destroyed() {
    this.end();
    for (const remove of this.listeners) remove();
  },
  listen(target, name, handler) {
    target.addEventListener(name, handler);
    (this.listeners ??= []).push(() => target.removeEventListener(name, handler));
  },
  // The button captures the pointer: the press goes on if the page moves under it, and ends if the hand leaves the button.
  grab(event) {
    this.el.setPointerCapture(event.pointerId);
    this.from = event;
    this.begin("pointer");
  },
  moved({ clientX: x, clientY: y }) {
    if (!this.timer || this.by !== "pointer" || Math.hypot(x - this.from.clientX, y - this.from.clientY) < TREMBLE_PX) return;
    const { left, right, top, bottom } = this.el.getBoundingClientRect();
    if (x < left || x > right || y < top || y > bottom) this.end("pointer");
  },
  press(event, keys) {
    if (event.key === "Escape") return this.end();
    if (!keys.includes(event.key)) return;
    event.preventDefault();
    if (!event.repeat) this.begin(event.key);
  },
  shortcut(event) {
    const key = this.el.dataset.shortcut;
    if (!key || event.ctrlKey || event.metaKey || event.altKey || typing(event.target)) return;
    // A dialog in front of the button keeps its keys to itself.
    if (document.querySelector("dialog[open]") && !this.el.closest("dialog[open]")) return;
    if (event.key.toLowerCase() === key.toLowerCase()) this.press(event, [event.key]);
  },
  begin(by) {
    if (this.timer || this.el.disabled || lost()) return;
    this.by = by;
    this.show("holding");
    this.timer = setTimeout(() => this.done(), Number(this.el.dataset.hold));
  },
  // Let go too early: says what to do instead.
  end(by) {
    if (!this.timer || (by && by !== this.by)) return;
    this.clear();
    this.show("slipped", 900);
  },
  done() {
    this.clear();
    this.show("held", 600);
    const value = { id: commandId() };
    for (const { name, value: text } of this.el.attributes) {
      if (name.startsWith("phx-value-")) value[name.slice("phx-value-".length)] = text;
    }
    // What the form around it says, as the operator sees it.
    const form = this.el.closest("form");
    if (form) value.fields = Object.fromEntries(new FormData(form));
    this.pushEvent(this.el.dataset.event, value);
  },
  clear() {
    clearTimeout(this.timer);
    this.timer = undefined;
  },
  // For the style sheet. The server's patches leave this attribute alone.
  show(state, ms) {
    clearTimeout(this.shown);
    this.el.dataset.state = state;
    // How often, because a state is soon over: for tests, and for whoever looks on by a script.
    if (ms) this.el.dataset[`${state}Count`] = Number(this.el.dataset[`${state}Count`] ?? 0) + 1;
    if (ms) this.shown = setTimeout(() => delete this.el.dataset.state, ms);
  },
};
