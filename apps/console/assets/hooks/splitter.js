// The bar between the fleet's map and its table, by pointer and keyboard, and the key \ that folds the table away. This browser keeps both. They
// are written on the document's root, which no page renders: what is selected does not depend on them.
import { typing } from "../lib/keyboard.js";

const SHARE = "fleet-map-share"; // the map's, in per cent
const FOLDED = "fleet-table-folded";
const [LEAST, MOST] = [20, 80];
const root = document.documentElement;

const bounded = (share) => Math.round(Math.min(MOST, Math.max(LEAST, share)));

function apply() {
  const share = Number.parseFloat(localStorage.getItem(SHARE));
  if (Number.isFinite(share)) root.style.setProperty("--fleet-map", `${bounded(share)}%`);
  root.classList.toggle("fleet-folded", localStorage.getItem(FOLDED) === "yes");
}

// Before the page is live, so that it does not jump.
apply();

export default {
  mounted() {
    [this.bar, this.button] = this.el.children;
    this.bar.addEventListener("pointerdown", (event) => this.grip(event));
    this.bar.addEventListener("pointermove", (event) => this.bar.hasPointerCapture(event.pointerId) && this.drag(event.clientX));
    this.bar.addEventListener("keydown", (event) => this.step(event));
    this.button.addEventListener("click", () => this.fold());
    this.key = (event) => {
      if (event.key !== "\\" || event.repeat || typing(event.target) || document.querySelector("dialog[open]")) return;
      event.preventDefault();
      this.fold();
    };
    window.addEventListener("keydown", this.key);
    this.tell();
  },

  destroyed() {
    window.removeEventListener("keydown", this.key);
  },

  box() {
    return this.el.parentElement.getBoundingClientRect();
  },

  // Where the bar is in the room of both.
  share() {
    const { left, width } = this.box();
    return bounded((100 * (this.bar.getBoundingClientRect().left - left)) / width);
  },

  grip(event) {
    if (event.button !== 0) return;
    event.preventDefault();
    this.bar.setPointerCapture(event.pointerId);
    this.bar.focus({ preventScroll: true });
  },

  drag(x) {
    const { left, width } = this.box();
    this.set((100 * (x - left)) / width);
  },

  step(event) {
    const wide = event.shiftKey ? 10 : 2;
    const to = { ArrowLeft: this.share() - wide, ArrowRight: this.share() + wide, Home: LEAST, End: MOST }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    this.set(to);
  },

  set(share) {
    localStorage.setItem(SHARE, bounded(share));
    apply();
    this.tell();
  },

  fold() {
    localStorage.setItem(FOLDED, root.classList.contains("fleet-folded") ? "no" : "yes");
    // What is hidden has no focus.
    if (document.activeElement?.closest("#fleet-list, .fleet-bar")) this.button.focus({ preventScroll: true });
    apply();
    this.tell();
  },

  tell() {
    const folded = root.classList.contains("fleet-folded");
    if (!folded) this.bar.setAttribute("aria-valuenow", this.share());
    this.button.setAttribute("aria-expanded", String(!folded));
  },
};
