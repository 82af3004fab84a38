// The hook of `Aerie.Console.Pages.Replay.Strip`: the time line below a map. It is read while it is open; a second of it, or a mark, opens the replay.
import { time } from "../lib/clock.js";
import { TimeLine } from "./time_line.js";

const KEPT = "time-strip";
const AGAIN_S = 60;
const STEPS_S = { ArrowLeft: -600, ArrowRight: 600, PageUp: -3600, PageDown: 3600, Home: -Infinity, End: Infinity };

export default {
  mounted() {
    this.words = this.el.querySelector("[data-words]");
    this.el.addEventListener("toggle", () => {
      localStorage.setItem(KEPT, String(this.el.open));
      this.ask();
    });
    this.handleEvent("strip:overview", (overview) => this.came(overview));
    // Opening it tells of it.
    this.el.open = localStorage.getItem(KEPT) === "true";
  },

  destroyed() {
    clearTimeout(this.timer);
    this.line?.destroy();
  },

  reconnected() {
    this.ask();
  },

  ask(seconds = AGAIN_S) {
    clearTimeout(this.timer);
    if (!this.el.open) return;
    if (this.liveSocket.isConnected()) this.pushEvent("strip", {});
    this.timer = setTimeout(() => this.ask(), seconds * 1000);
  },

  came({ problem, again, ...overview }) {
    if (again) {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.ask(), again * 1000);
    }
    this.words.textContent = problem ?? "UTC. A click opens the replay at that second; with the keyboard, the arrows and Enter.";
    if (problem) return;
    this.line ??= this.made();
    this.line.put(overview);
    this.move(Math.min(Math.max(this.at ?? overview.to, overview.from), overview.to));
  },

  made() {
    const open = (at) => this.open(at);
    const line = new TimeLine(this.el.querySelector("[data-line]"), { seek: open, mark: ({ at }) => open(at), viewed: () => {} });
    line.svg.addEventListener("keydown", (event) => this.key(event));
    return line;
  },

  key(event) {
    const step = STEPS_S[event.key];
    if (step) this.move(Math.min(Math.max(this.at + step, this.line.from), this.line.to));
    else if (event.key === "Enter") this.open(this.at);
    else return;
    event.preventDefault();
    event.stopPropagation();
  },

  move(at) {
    this.at = at;
    this.line.cursor(at, `${time(at)} UTC; Enter opens the replay`);
  },

  open(at) {
    this.js().navigate(`/replay?${new URLSearchParams({ at: new Date(Math.round(at) * 1000).toISOString() })}`);
  },
};
