// Charts of chosen fields, one for each unit, with a common time. The server sends a row of samples at a time (`chart`). Pausing
// keeps the picture while samples go on being collected; dragging zooms; a double click, or Live, goes back to the present.
import { Samples } from "./chart/samples.js";
import { time, ZONE } from "../lib/clock.js";
import { button as plain, element } from "../lib/dom.js";
import { save } from "../lib/files.js";
import { color } from "../lib/theme.js";

const ROWS = 3000;
const WINDOWS = [[60, "1 min"], [300, "5 min"], [600, "10 min"]];
const HEIGHT = 200;

const COLORS = 8;
const number = (v) => (v === null || v === undefined ? "–" : Number.parseFloat(v.toPrecision(7)).toString());

const button = (label, title, act) => Object.assign(plain(label, act), { title });

export default {
  async mounted() {
    this.window = WINDOWS[0][0];
    this.zoom = null;
    this.paused = false;
    this.plots = [];
    this.samples = new Samples([], ROWS);
    this.place = this.el.querySelector("[data-plots]");
    this.resize = new ResizeObserver(() => this.fit());
    this.theme = () => { this.colors(); this.plots.forEach(({ plot }) => plot.redraw()); };
    this.handleEvent("chart", (row) => {
      if (row.chart === this.el.id) this.row(row);
    });
    // It may come before the package that draws.
    this.handleEvent("chart_history", ({ chart, rows }) => {
      if (chart !== this.el.id) return;
      this.history = rows;
      if (this.uPlot) this.show();
    });
    this.tools();
    this.colors();
    const { default: uPlot } = await import("../npm/uplot/uPlot.esm.js");
    if (this.gone) return;
    this.uPlot = uPlot;
    this.choose();
    this.resize.observe(this.place);
    window.addEventListener("theme", this.theme);
  },

  updated() {
    if (this.uPlot && this.el.dataset.series !== this.chosen) this.choose();
  },

  destroyed() {
    this.gone = true;
    this.resize.disconnect();
    window.removeEventListener("theme", this.theme);
    this.plots.forEach(({ plot }) => plot.destroy());
  },

  colors() {
    this.lines = Array.from({ length: COLORS }, (_none, i) => color(`--chart-${i + 1}`));
    [this.muted, this.grid] = [color("--muted"), color("--line")];
  },

  tools() {
    const span = element("select", { "aria-label": "time shown" });
    for (const [seconds, label] of WINDOWS) span.add(new Option(label, seconds));
    span.addEventListener("change", () => { this.window = Number(span.value); this.live(); });
    this.pause = button("Pause", "freeze the picture; samples are still collected", () => this.hold(!this.paused));
    this.pause.setAttribute("aria-pressed", "false");
    const bar = element("div", { className: "chart-tools" });
    bar.append(span, this.pause, button("Live", "back to the present", () => this.live()),
      button("Export CSV", "save what is shown as a file", () => this.save()));
    this.list = element("div");
    this.place.replaceChildren(bar, this.list);
  },

  // data-series: [{"key", "label", "unit"}]
  choose() {
    this.chosen = this.el.dataset.series;
    this.series = JSON.parse(this.chosen);
    const keys = this.series.map(({ key }) => key);
    this.samples.choose(keys);
    this.plots.forEach(({ plot }) => plot.destroy());
    if (this.history) this.samples.before(this.history);
    this.history = undefined;
    const units = [...new Set(this.series.map(({ unit }) => unit))];
    this.plots = units.map((unit) => this.plot(unit, this.series.filter((one) => one.unit === unit)));
  },

  plot(unit, series) {
    const axis = () => this.muted;
    const font = `12px ${getComputedStyle(this.el).fontFamily}`;
    const grid = { stroke: () => this.grid, width: 1 };
    const lines = series.map(({ key, label }) => {
      const n = this.series.findIndex((one) => one.key === key);
      return { label, stroke: () => this.lines[n % COLORS], width: 1.5, spanGaps: false, value: (_plot, v) => number(v) };
    });
    const keys = series.map(({ key }) => key);
    const plot = new this.uPlot({
      width: this.place.clientWidth || 320, height: HEIGHT,
      scales: { x: { time: true, range: () => this.range() } },
      tzDate: (seconds) => this.uPlot.tzDate(new Date(seconds * 1000), ZONE),
      series: [{ label: ZONE, value: (_plot, v) => (v === null ? "–" : time(v)) }, ...lines],
      // uPlot's own labels have the browser's language: 2:39pm, 1,5.
      axes: [{ stroke: axis, font, grid, ticks: grid, values: (_plot, times, _axis, _space, step) => times.map((at) => time(at, step >= 60)) },
        { stroke: axis, font, labelFont: font, grid, ticks: grid, values: (_plot, values) => values.map(number), label: unit || undefined, labelSize: unit ? 18 : 0, size: 56 }],
      cursor: { sync: { key: this.el.id }, drag: { x: true, y: false, setScale: false } },
      hooks: { setSelect: [(plot) => this.select(plot)] },
    }, this.samples.data(keys), this.list);
    plot.over.addEventListener("dblclick", () => this.live());
    return { plot, keys };
  },

  range() {
    if (this.zoom) return this.zoom;
    const last = this.samples.times.at(-1) ?? Date.now() / 1000;
    return [last - this.window, last];
  },

  select(plot) {
    const { left, width } = plot.select;
    if (width < 5) return;
    this.zoom = [plot.posToVal(left, "x"), plot.posToVal(left + width, "x")];
    this.plots.forEach(({ plot }) => plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false));
    this.show();
  },

  hold(paused) {
    this.paused = paused;
    this.pause.textContent = paused ? "Resume" : "Pause";
    this.pause.setAttribute("aria-pressed", String(paused));
    if (paused) this.zoom ??= this.range();
    else this.live();
  },

  live() {
    this.zoom = null;
    if (this.paused) this.hold(false);
    else this.show();
  },

  row({ time, values }) {
    this.samples.push(time, values);
    if (!this.paused && !document.hidden) this.show();
  },

  show() {
    if (this.history) this.samples.before(this.history);
    this.history = undefined;
    for (const { plot, keys } of this.plots) plot.setData(this.samples.data(keys));
  },

  fit() {
    const width = this.place.clientWidth;
    if (width > 0) this.plots.forEach(({ plot }) => plot.setSize({ width, height: HEIGHT }));
  },

  save() {
    const keys = this.series.map(({ key }) => key);
    const [from, to] = this.zoom ?? [];
    save(`${this.el.dataset.vehicle}-${new Date().toISOString().replaceAll(":", "-")}.csv`, this.samples.csv(keys, { from, to }), "text/csv");
  },
};
