// A button that does something only after it was held for `data-hold` milliseconds, by pointer, Space or Enter, or by the key of
// `data-shortcut` wherever the focus is. What it is for is taken when the press begins; if that changes, the press ends.
import { commandId } from "../lib/command_id.js";
import { hint } from "../lib/hint.js";
import { shown } from "../lib/shown.js";

const lost = () => document.documentElement.classList.contains("gateway-lost");
const TREMBLE_PX = 8;
const SLIPPED_MS = 1500;
const field = (target) => target.closest?.("input, select, textarea, [contenteditable]");
const text = (target) => !target.matches("select, [type=checkbox], [type=radio], [type=range], [type=button], [type=submit], [type=file]");
const called = (target) => target.getAttribute("aria-label") ?? target.labels?.[0]?.textContent.trim() ?? "a field";

export default {
  mounted() {
    const { el } = this;
    this.listen(el, "pointerdown", (event) => { if (event.button === 0) this.grab(event); });
    this.listen(el, "pointermove", (event) => this.moved(event));
    this.listen(el, "pointerup", (event) => this.release("pointer", event));
    for (const name of ["pointercancel", "lostpointercapture"]) this.listen(el, name, () => this.end("pointer"));
    this.listen(el, "contextmenu", (event) => event.preventDefault());
    this.listen(el, "blur", () => this.end());
    this.listen(el, "keydown", (event) => this.press(event, ["Enter", " "]));
    this.listen(window, "keydown", (event) => this.shortcut(event));
    this.listen(window, "keyup", (event) => this.release(event.key === "Shift" && this.by === "Escape" ? this.by : event.key, event));
    this.listen(window, "blur", () => this.end());
    this.listen(window, "gateway", () => this.end());
  },
  updated() {
    if (this.el.disabled) this.end();
    else if (this.timer && (this.el.dataset.refusal || this.changed())) this.end(undefined, "Changed");
  },
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
    this.begin("pointer", event);
  },
  moved({ clientX: x, clientY: y }) {
    if (!this.timer || this.by !== "pointer" || Math.hypot(x - this.from.clientX, y - this.from.clientY) < TREMBLE_PX) return;
    const { left, right, top, bottom } = this.el.getBoundingClientRect();
    if (x < left || x > right || y < top || y > bottom) this.end("pointer");
  },
  press(event, keys) {
    if (event.key === "Escape" && !keys.includes("Escape")) return this.end();
    if (!keys.includes(event.key)) return;
    event.preventDefault();
    if (!event.repeat) this.begin(event.key, event);
  },
  shortcut(event) {
    const { shortcut: key } = this.el.dataset;
    if (!key || event.ctrlKey || event.metaKey || event.altKey) return;
    // Nobody types Shift and Escape, and no dialog keeps them to itself.
    if (key === "Shift+Escape") return event.shiftKey && this.press(event, [event.key === "Escape" ? event.key : undefined]);
    if (event.key.toLowerCase() !== key.toLowerCase()) return;
    // A dialog in front of the button keeps its keys to itself.
    if (document.querySelector("dialog[open]") && !this.el.closest("dialog[open]")) return;
    const target = field(event.target);
    // A letter that somebody types is none that is held.
    if (target && text(target) && !event.repeat) return;
    if (target) return hint(`${key} does nothing while “${called(target)}” has the focus. Move the focus away, then hold ${key}.`);
    const { keyRefusal } = this.el.dataset;
    if (keyRefusal) return event.repeat || hint(keyRefusal);
    this.press(event, [event.key]);
  },
  begin(by, event) {
    if (this.timer || this.el.matches(":disabled")) return;
    // The hand on the button and the key do the same, and learn the same.
    const refusal = lost() ? "Nothing is sent while the gateway is lost." : this.el.dataset.refusal;
    if (refusal) return hint(refusal);
    this.by = by;
    this.since = Math.min(event.timeStamp, performance.now());
    this.value = JSON.stringify(shown(this.el));
    this.show("holding");
    this.timer = setTimeout(() => this.ripe(), this.since + this.ms() - performance.now());
  },
  ms() {
    return Number(this.el.dataset.hold);
  },
  // A busy page may have the release waiting behind this timer: releases come first, and are judged by their own time.
  ripe() {
    const again = navigator.scheduling?.isInputPending?.() ? () => this.ripe() : () => this.done();
    this.timer = setTimeout(again);
  },
  // The hand's own times count, not when the page came to deal with them.
  release(by, { timeStamp }) {
    if (this.timer && by === this.by && timeStamp - this.since >= this.ms()) this.done();
    else this.end(by);
  },
  // Let go too early: says what to do instead.
  end(by, words = "Keep pressing") {
    if (!this.timer || (by && by !== this.by)) return;
    this.clear();
    this.el.dataset.slip = words;
    this.show("slipped", SLIPPED_MS);
  },
  changed() {
    return JSON.stringify(shown(this.el)) !== this.value;
  },
  done() {
    if (this.changed()) return this.end(undefined, "Changed");
    this.clear();
    this.show("held", 600);
    this.pushEvent(this.el.dataset.event, { id: commandId(), ...JSON.parse(this.value) });
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
