// The time line of the replay: a row for each vehicle, marks by their shape, a cursor. It is one slider for the keyboard and for screen
// readers; its keys are those of the page (replay.js).
import { time } from "../lib/clock.js";
import { element } from "../lib/svg.js";

const ROW = 20;
const TOP = 22;
const SHORTEST_S = 60;
const NEAR = 9; // pixels around a mark
const STEPS = [10, 30, 60, 300, 600, 1800, 3600, 3 * 3600, 6 * 3600];
const CLASSES = { 1: "heard", 2: "air", 3: "lost" };
const SIGNS = { critical: "▲", warning: "△", done: "◆", refused: "◇", landed: "⌂" };

export class TimeLine {
  constructor(el, { seek, mark, viewed }) {
    Object.assign(this, { el, seek, onMark: mark, viewed, rows: [], marks: [], fine: new Map(), chosen: null });
    el.innerHTML = `<div class="time-line-scroll"><svg role="slider" tabindex="0" aria-label="Time of the replay" aria-valuenow="0" aria-valuetext="Not loaded yet"></svg></div>`;
    this.svg = el.querySelector("svg");
    this.resize = new ResizeObserver(() => this.draw());
    this.resize.observe(el);
    this.svg.addEventListener("pointerdown", (event) => this.press(event));
    this.svg.addEventListener("pointermove", (event) => this.pressed && this.seek(this.time(event)));
    for (const name of ["pointerup", "pointercancel"]) this.svg.addEventListener(name, () => { this.pressed = false; });
    this.svg.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(event.deltaY > 0 ? 1.25 : 0.8, this.time(event));
    }, { passive: false });
  }

  destroy() {
    this.resize.disconnect();
  }

  put({ from, to, rows, marks }) {
    const live = !this.view || this.view.to === this.to;
    Object.assign(this, { from, to, rows, marks });
    this.view ??= { from, to };
    if (live) this.view = { from: Math.max(from, to - (this.view.to - this.view.from)), to };
    this.draw();
  }

  // What is known to the second, in place of what is known to the minute.
  refine(from, to, spans) {
    this.fine.set(from, { from, to, spans });
    while (this.fine.size > 60) this.fine.delete(this.fine.keys().next().value);
    this.draw();
  }

  cursor(at, words) {
    this.at = at;
    for (const [name, value] of [["min", Math.round(this.from)], ["max", Math.round(this.to)], ["now", Math.round(at)], ["text", words]]) this.svg.setAttribute(`aria-value${name}`, value);
    const { from, to } = this.view;
    if (at < from || at > to) this.look(at - (to - from) / 2, to - from);
    else this.place();
  }

  zoom(factor, about) {
    if (!this.view) return;
    const span = this.view.to - this.view.from;
    const wanted = Math.min(Math.max(span * factor, SHORTEST_S), this.to - this.from);
    this.look(about - ((about - this.view.from) / span) * wanted, wanted);
  }

  look(from, span) {
    const first = Math.min(Math.max(from, this.from), this.to - span);
    this.view = { from: first, to: first + span };
    this.draw();
  }

  get label() {
    return this.el.clientWidth < 600 ? 70 : 120;
  }

  x(at) {
    const { from, to } = this.view;
    return this.label + ((at - from) / (to - from)) * (this.el.clientWidth - this.label - 8);
  }

  time({ clientX }) {
    const { from, to } = this.view;
    const x = clientX - this.svg.getBoundingClientRect().left - this.label;
    return from + (x / (this.el.clientWidth - this.label - 8)) * (to - from);
  }

  press(event) {
    if (!this.view) return;
    const box = this.svg.getBoundingClientRect();
    const row = Math.floor((event.clientY - box.top - TOP) / ROW);
    const far = (mark) => Math.abs(this.x(mark.at) - (event.clientX - box.left));
    const [nearest] = this.marks.filter((mark) => this.line(mark) === row && far(mark) <= NEAR).sort((a, b) => far(a) - far(b));
    if (nearest) return this.onMark(nearest);
    this.pressed = true;
    this.svg.setPointerCapture(event.pointerId);
    this.seek(this.time(event));
  }

  line({ vehicle }) {
    return Math.max(0, this.rows.findIndex(({ id }) => id === vehicle));
  }

  draw() {
    if (!this.view || !this.el.clientWidth) return;
    const height = TOP + Math.max(1, this.rows.length) * ROW + 4;
    this.svg.setAttribute("width", this.el.clientWidth);
    this.svg.setAttribute("height", height);
    const hatch = element("pattern", { id: "time-line-hatch", width: 6, height: 6, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" }, element("rect", { width: 3, height: 6, class: "hatch" }));
    const parts = [element("defs", {}, hatch), ...this.axis(height)];
    this.rows.forEach((row, index) => parts.push(...this.row(row, index)));
    for (const mark of this.marks) if (mark.at >= this.view.from && mark.at <= this.view.to) parts.push(this.sign(mark));
    this.needle = element("line", { class: "cursor", y1: 0, y2: height });
    this.svg.replaceChildren(...parts, this.needle);
    this.place();
    this.viewed();
  }

  place() {
    if (this.at == null || !this.needle) return;
    const x = this.x(this.at);
    this.needle.setAttribute("x1", x);
    this.needle.setAttribute("x2", x);
  }

  axis(height) {
    const { from, to } = this.view;
    const most = Math.max(2, (this.el.clientWidth - this.label) / 80);
    const step = STEPS.find((s) => (to - from) / s <= most) ?? STEPS.at(-1);
    const parts = [];
    for (let at = Math.ceil(from / step) * step; at <= to; at += step) {
      parts.push(element("line", { class: "tick", x1: this.x(at), x2: this.x(at), y1: TOP - 4, y2: height }));
      parts.push(text("time", this.x(at), 12, time(at, step >= 60), "middle"));
    }
    return parts;
  }

  row({ id, spans }, index) {
    const y = TOP + index * ROW + ROW / 2;
    const parts = [text("name", 4, y + 4, id.length > this.label / 7 ? `${id.slice(0, this.label / 7 - 1)}…` : id, "start")];
    const known = [...this.fine.values()].filter(({ from, to }) => to > this.view.from && from < this.view.to);
    const coarse = known.reduce((left, { from, to }) => left.flatMap((span) => without(span, from, to)), spans);
    for (const [from, to, state] of [...coarse, ...known.flatMap(({ spans }) => spans[id] ?? [])]) {
      if (to < this.view.from || from > this.view.to) continue;
      const [x1, x2] = [Math.max(this.x(from), this.label), Math.min(this.x(to), this.el.clientWidth - 8)];
      const thick = state === 1 ? 2 : 8;
      parts.push(element("rect", { class: CLASSES[state], x: x1, y: y - thick / 2, width: Math.max(x2 - x1, 1), height: thick }));
    }
    return parts;
  }

  sign(mark) {
    const y = TOP + this.line(mark) * ROW + ROW / 2 + 5;
    const sign = text(`mark ${mark.kind}${mark === this.chosen ? " chosen" : ""}`, this.x(mark.at), y, SIGNS[mark.kind], "middle");
    sign.append(element("title", {}, `${time(mark.at)} ${mark.vehicle ?? ""}: ${mark.text}`));
    return sign;
  }
}

// What is left of a span outside of another one.
function without([from, to, state], first, last) {
  if (to <= first || from >= last) return [[from, to, state]];
  return [[from, first, state], [last, to, state]].filter(([a, b]) => b > a);
}

const text = (kind, x, y, words, anchor) => element("text", { class: kind, x, y, "text-anchor": anchor }, words);
