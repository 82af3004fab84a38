// The primary flight display of one vehicle. The server sends samples (`instruments`); what stands between two of them is
// interpolated. A vehicle that is silent keeps its last picture, crossed out, so that nobody takes it for the present.
import { horizon } from "./instruments/horizon.js";
import { Motion } from "./instruments/motion.js";
import { element, line, put, text } from "../lib/svg.js";
import { tape } from "./instruments/tape.js";

const SILENT = 3000;
const POINTS = { 0: "N", 45: "NE", 90: "E", 135: "SE", 180: "S", 225: "SW", 270: "W", 315: "NW" };

const turn = (degrees) => ((Math.round(degrees) % 360) + 360) % 360;
const short = (n) => (Math.abs(n) < 10 ? n.toFixed(1) : Math.round(n).toString());
const known = (n) => (typeof n === "number" ? n : null);

export default {
  mounted() {
    this.motion = new Motion();
    this.still = window.matchMedia("(prefers-reduced-motion: reduce)");
    // On a phone they would cover the map.
    if (window.matchMedia("(max-width: 700px)").matches) this.el.closest("details")?.removeAttribute("open");
    this.draw();
    this.handleEvent("instruments", (sample) => {
      if (sample.vehicle === this.el.dataset.vehicle) this.sample(sample);
    });
    this.frame = null;
    this.watch = setInterval(() => this.judge(), 500);
    this.judge();
  },

  updated() { this.judge(); },
  disconnected() { this.cut = true; this.judge(); },
  reconnected() { this.cut = false; this.judge(); },

  destroyed() {
    clearInterval(this.watch);
    if (this.frame) cancelAnimationFrame(this.frame);
  },

  draw() {
    const id = this.el.id;
    this.horizon = horizon({ x: 72, y: 8, width: 256, height: 226, id: `${id}-horizon` });
    this.speed = tape({ x: 2, y: 8, width: 62, height: 226, step: 1, every: 5, pixels: 9, side: "right", value: short, id: `${id}-speed` });
    this.height = tape({ x: 336, y: 8, width: 62, height: 226, step: 2, every: 5, pixels: 4, side: "left", value: short, id: `${id}-height` });
    this.heading = tape({
      x: 72, y: 246, width: 256, height: 32, step: 5, every: 3, pixels: 3, level: true,
      label: (n) => POINTS[turn(n)] ?? String(turn(n)), value: (n) => `${String(turn(n)).padStart(3, "0")}°`, id: `${id}-heading`,
    });
    this.climb = text(367, 268, "pfd-note pfd-middle");
    this.air = text(33, 268, "pfd-note pfd-middle");
    this.words = text(200, 128, "pfd-words pfd-middle");
    this.svg = element("svg", { viewBox: "0 0 400 312", role: "img", "aria-label": "no data yet" },
      this.horizon.node, this.speed.node, this.height.node, this.heading.node,
      text(33, 250, "pfd-unit pfd-middle", "m/s"), text(367, 250, "pfd-unit pfd-middle", "m"), this.climb, this.air,
      element("g", { class: "pfd-cross" }, line(72, 8, 328, 234, ""), line(328, 8, 72, 234, "")), this.words);
    this.el.replaceChildren(this.svg);
    this.paint({ roll: null, pitch: null, heading: null, height: null, speed: null, climb: null, airspeed: null });
  },

  sample(sample) {
    const now = performance.now();
    const values = {};
    for (const name of ["roll", "pitch", "heading", "height", "speed", "climb", "airspeed"]) values[name] = known(sample[name]);
    this.heard = now;
    this.motion.push(values, now);
    if (this.still.matches || document.hidden) this.paint(values);
    else this.frame ??= requestAnimationFrame((at) => this.step(at));
    this.judge();
  },

  step(now) {
    this.paint(this.motion.at(now));
    this.frame = this.motion.settled(now) ? null : requestAnimationFrame((at) => this.step(at));
  },

  paint(values) {
    this.horizon.show(values.roll, values.pitch);
    this.speed.show(values.speed);
    this.height.show(values.height);
    this.heading.show(values.heading);
    put(this.climb, values.climb === null ? "" : `${values.climb < 0 ? "▼" : "▲"} ${Math.abs(values.climb).toFixed(1)}`);
    put(this.air, values.airspeed === null ? "" : `air ${short(values.airspeed)}`);
  },

  // Says what is wrong with the picture, if something is; the label is for those who do not see it.
  judge() {
    const { status } = this.el.dataset;
    const nothing = Object.values(this.motion.to).every((value) => value === null);
    const quiet = nothing || performance.now() - this.heard > SILENT;
    const words = this.cut ? "GATEWAY LOST" : status === "lost" ? "VEHICLE LOST" : status === "stale" ? "STALE" : quiet ? "NO DATA" : "";
    this.el.classList.toggle("pfd-dead", words !== "");
    put(this.words, words);
    const { roll, pitch, heading, height, speed } = this.motion.to;
    const say = (name, n, unit) => (n === null || n === undefined ? `${name} unknown` : `${name} ${Math.round(n)} ${unit}`);
    const label = [say("roll", roll, "degrees"), say("pitch", pitch, "degrees"), say("heading", heading, "degrees"),
      say("height", height, "metres"), say("speed", speed, "metres per second")].join(", ");
    this.svg.setAttribute("aria-label", words === "" ? label : `${words.toLowerCase()}; last: ${label}`);
  },
};
