// The page Replay: which second is shown, playing, keys, and the map at that second. The time line draws itself (time_line.js); chunks of
// samples come from the page and are kept.
import { time } from "../lib/clock.js";
import { collection, feature } from "./map/geo.js";
import { TimeLine } from "./time_line.js";

const GAP_S = 5; // in the air; no line is drawn over it
const GROUND_S = 65; // on the ground, and lost: one sample each 30 s, and one each minute
const TAIL_S = 60;
const CHUNKS = 60;
const STEP_MS = 100;
const AGAIN_MS = 10_000;
const [AT, LAT, LON, HEIGHT, HEADING, SPEED, BATTERY, MODE, STATE, IN_AIR] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9];

const typing = (target) => target.closest?.("input, select, textarea, [contenteditable], dialog");

export default {
  mounted() {
    this.chunkS = Number(this.el.dataset.chunk);
    this.chunks = new Map(); // by their first second: null while they are on their way
    this.kinds = new Map();
    this.at = Number(this.el.dataset.at) || null;
    this.speed = 1;
    this.line = new TimeLine(this.el.querySelector("#replay-line"), {
      seek: (at) => this.seek(at),
      mark: (mark) => this.show(mark),
      viewed: () => this.viewed(),
    });
    const on = (name, event, act) => this.el.querySelector(`[data-${name}]`).addEventListener(event, act);
    on("play", "click", () => this.play(!this.timer));
    on("speed", "change", ({ target }) => { this.speed = Number(target.value); });
    on("before", "click", () => this.event(-1));
    on("after", "click", () => this.event(1));
    on("in", "click", () => this.line.zoom(0.5, this.at));
    on("out", "click", () => this.line.zoom(2, this.at));
    this.el.addEventListener("submit", (event) => this.choose(event));
    this.keys = (event) => this.key(event);
    window.addEventListener("keydown", this.keys);
    this.clock = setInterval(() => this.badge(), 1000);
    this.handleEvent("replay:chunk", (chunk) => this.came(chunk));
    this.handleEvent("replay:packing", ({ text }) => this.packing?.(`Packing… ${text}`));
    this.handleEvent("replay:overview", (overview) => this.overview(overview));
  },

  destroyed() {
    this.play(false);
    clearInterval(this.clock);
    window.removeEventListener("keydown", this.keys);
    this.line.destroy();
  },

  // What the page asks while nobody answers is asked again.
  disconnected() { this.cut = true; },
  reconnected() {
    this.cut = false;
    if (this.to) this.need();
  },

  overview({ from, to, rows, marks }) {
    this.from = from;
    this.to = to;
    for (const { id, kind } of rows) this.kinds.set(id, kind);
    this.at = Math.min(Math.max(this.at ?? to - 60, from), to);
    this.line.put({ from, to, rows, marks });
    // The present chunk has grown since.
    for (const first of this.chunks.keys()) if (first + this.chunkS > to - 60) this.chunks.delete(first);
    this.seek(this.at);
  },

  key(event) {
    const { key, target, ctrlKey, metaKey, altKey } = event;
    if (ctrlKey || metaKey || altKey || typing(target) || document.querySelector("dialog[open]")) return;
    const onMap = target.closest?.(".map");
    // With Shift it is the header's, which aborts what flies now.
    if (key === "Escape") return event.shiftKey ? undefined : this.el.querySelector("#replay-live").click();
    if (this.at === null || !this.to || onMap) return;
    if (key === " " && !target.closest?.("button, a, summary")) this.play(!this.timer);
    else if (key === "ArrowLeft") event.shiftKey ? this.seek(this.at - 1) : this.event(-1);
    else if (key === "ArrowRight") event.shiftKey ? this.seek(this.at + 1) : this.event(1);
    else if (key === "Home") this.seek(this.from);
    else if (key === "End") this.seek(this.to);
    else if (key === "PageUp") this.seek(this.at - 60);
    else if (key === "PageDown") this.seek(this.at + 60);
    else if (key === "+" || key === "=") this.line.zoom(0.5, this.at);
    else if (key === "-") this.line.zoom(2, this.at);
    else return;
    event.preventDefault();
  },

  play(on) {
    clearInterval(this.timer);
    this.timer = undefined;
    const button = this.el.querySelector("[data-play]");
    button.textContent = on ? "Pause" : "Play";
    button.setAttribute("aria-pressed", String(on));
    if (!on) return this.address();
    let before = performance.now();
    this.timer = setInterval(() => {
      const now = performance.now();
      const at = this.at + ((now - before) / 1000) * this.speed;
      before = now;
      if (at < this.to) return this.seek(at, false);
      this.seek(this.to);
      this.play(false);
    }, STEP_MS);
  },

  // To the next mark in a direction.
  event(direction) {
    const marks = this.line.marks.filter(({ at }) => (direction > 0 ? at > this.at + 0.5 : at < this.at - 0.5));
    const mark = direction > 0 ? marks[0] : marks.at(-1);
    if (!mark) return this.say(direction > 0 ? "No later event." : "No earlier event.");
    this.show(mark);
  },

  show(mark) {
    this.line.chosen = mark;
    this.seek(mark.at);
    const lines = [`${time(mark.at)} ${mark.vehicle ?? "gateway"}: ${mark.text}`];
    if (mark.rule) lines.push(`Rule: ${mark.rule}`);
    if (mark.who) lines.push(`By ${mark.who}`);
    if (mark.took_ms != null) lines.push(`Took ${mark.took_ms} ms`);
    this.say(lines.join(" · "));
    if (mark.record) {
      const link = Object.assign(document.createElement("a"), { href: `/audit?record=${mark.record}`, textContent: `Audit, record ${mark.record}` });
      this.el.querySelector("#replay-card").append(" ", link);
    }
  },

  say(text) {
    this.el.querySelector("#replay-card").textContent = text;
  },

  seek(at, settled = true) {
    if (!this.to) return;
    this.at = Math.min(Math.max(at, this.from), this.to);
    this.line.cursor(this.at, this.words());
    this.badge();
    this.need();
    this.draw();
    if (settled) this.address();
  },

  words() {
    const flying = this.now?.filter((row) => row.inAir).length ?? 0;
    return `${time(this.at)} UTC, ${ago(Date.now() / 1000 - this.at)}, ${flying} in the air`;
  },

  badge() {
    if (this.at === null) return;
    this.el.querySelector("[data-badge]").textContent = `${time(this.at)}, ${ago(Date.now() / 1000 - this.at)}`;
  },

  // The address says what is seen, so that it can be given to others.
  address() {
    if (this.at === null || !this.to) return;
    const at = new Date(Math.round(this.at) * 1000).toISOString().replace(".000Z", "Z");
    const { vehicles } = this.el.dataset;
    const query = new URLSearchParams({ at, ...(vehicles ? { vehicles } : {}) });
    clearTimeout(this.writing);
    // Browsers refuse too many changes of the address.
    this.writing = setTimeout(() => history.replaceState(history.state, "", `/replay?${query.toString().replaceAll("%3A", ":").replaceAll("%2C", ",")}`), 300);
  },

  // Other vehicles at the same second: the page is read anew for them.
  choose(event) {
    event.preventDefault();
    if ("incident" in event.target.dataset) return this.pack(event.target);
    const boxes = [...event.target.querySelectorAll("input[name=vehicle]")];
    const ids = boxes.filter(({ checked }) => checked).map(({ value }) => value);
    const vehicles = ids.length && ids.length < boxes.length ? { vehicles: ids.join(",") } : {};
    const at = this.at === null ? {} : { at: new Date(Math.round(this.at) * 1000).toISOString() };
    this.js().navigate(`/replay?${new URLSearchParams({ ...at, ...vehicles })}`);
  },

  viewed() {
    const { from, to } = this.line.view;
    this.el.dataset.view = `${Math.round(from)} ${Math.round(to)}`;
    const span = this.el.querySelector("[data-span]");
    if (span) span.textContent = `${time(from)} to ${time(to)} UTC`;
  },

  // One vehicle and the time in view as an archive, which the gateway packs meanwhile.
  async pack(form) {
    const say = (text) => { form.querySelector("[data-packing]").textContent = text; };
    const button = form.querySelector("button");
    const { from, to } = this.line.view;
    const query = new URLSearchParams({ vehicle: form.elements.vehicle.value, from: Math.floor(from), to: Math.ceil(to) });
    button.disabled = true;
    say("Packing…");
    this.packing = say;
    try {
      const answer = await fetch(`/download/incident?${query}`);
      if (answer.redirected) return location.assign("/sign-in");
      if (!answer.ok) return say(await answer.text());
      const file = await answer.blob();
      const [, name] = answer.headers.get("content-disposition").match(/filename="(.*)"/);
      const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(file), download: name });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
      say(`${name}, ${(file.size / 1e6).toFixed(1)} MB`);
    } catch {
      say("The connection to the gateway broke off. Try again.");
    } finally {
      button.disabled = false;
      this.packing = null;
    }
  },

  // Chunks: the one of the second, the one of the tail, and the next one.

  chunk(at) {
    return Math.floor(at / this.chunkS) * this.chunkS;
  },

  need() {
    for (const at of [this.at, this.at - TAIL_S, this.at + this.chunkS]) this.fetch(this.chunk(at));
    while (this.chunks.size > CHUNKS) this.chunks.delete(this.chunks.keys().next().value);
  },

  fetch(from) {
    if (this.cut || this.chunks.has(from) || from + this.chunkS < this.from || from > this.to) return;
    this.chunks.set(from, null);
    this.pushEvent("chunk", { from });
    // A request may be refused, or lost with the gateway.
    setTimeout(() => this.chunks.get(from) === null && this.chunks.delete(from), AGAIN_MS);
  },

  came({ from, vehicles }) {
    this.chunks.set(from, vehicles);
    this.line.refine(from, Math.min(from + this.chunkS, this.to), fine(vehicles));
    this.draw();
  },

  rows(id, from, to) {
    const rows = [];
    for (let first = this.chunk(from); first <= to; first += this.chunkS) rows.push(...(this.chunks.get(first)?.[id] ?? []));
    return rows;
  },

  draw() {
    // The page is left, and what plays has its last turn.
    if (!this.el.isConnected) return;
    const map = this.el.querySelector("#replay-map")?.fleetMap;
    const ids = new Set();
    for (const first of [this.chunk(this.at), this.chunk(this.at - GROUND_S)]) for (const id of Object.keys(this.chunks.get(first) ?? {})) ids.add(id);
    const tails = [];
    this.now = [];
    for (const id of ids) {
      const rows = this.rows(id, this.at - GROUND_S, this.at + GAP_S);
      const index = rows.findLastIndex((row) => row[AT] <= this.at);
      const place = index < 0 ? null : between(rows[index], rows[index + 1], this.at);
      if (place) this.now.push({ id, ...place });
      for (const tail of tailOf(rows.slice(0, index + 1), place, this.at)) tails.push(feature("LineString", tail, { id }));
    }
    this.el.dataset.shown = this.now.map(({ id }) => id).sort().join(",");
    if (!map) return void setTimeout(() => this.draw(), 500);
    this.onMap(map, tails);
  },

  onMap(map, tails) {
    const rows = this.now.map(({ id, lat, lon, row, inAir }) => [id, lat, lon, row[HEADING], null, row[SPEED], row[HEIGHT], this.kinds.get(id) ?? null, row[STATE], inAir]);
    if (!map.map.getSource("replay-tails")) {
      map.showTracks?.(false);
      map.map.addSource("replay-tails", { type: "geojson", data: collection() });
      map.map.addLayer({
        id: "replay-tails", type: "line", source: "replay-tails",
        layout: { "line-join": "round", "line-cap": "round" },
        paint: { "line-color": map.colours().track, "line-width": 3 },
      }, "vehicles-course");
    }
    map.map.getSource("replay-tails").setData(collection(tails));
    // As if the server had pushed it.
    window.dispatchEvent(new CustomEvent("phx:map:vehicles", { detail: { map: "replay-map", all: true, exact: true, vehicles: rows, gone: [] } }));
  },
};

// The place between two samples, if they are so near that the way between is known; null where nothing is known.
function between(row, next, at) {
  const age = at - row[AT];
  if (age > (row[IN_AIR] && row[STATE] !== "lost" ? GAP_S : GROUND_S)) return null;
  const share = next && next[AT] - row[AT] <= GAP_S ? age / (next[AT] - row[AT]) : 0;
  const mean = (field) => row[field] + (share ? (next[field] - row[field]) * share : 0);
  return { lat: mean(LAT), lon: mean(LON), row, inAir: row[IN_AIR], mode: row[MODE], battery: row[BATTERY] };
}

// The way of the last minute, in pieces between gaps.
function tailOf(rows, place, at) {
  const pieces = [[]];
  let before = null;
  for (const row of rows) {
    if (row[AT] < at - TAIL_S) continue;
    if (before !== null && row[AT] - before > GAP_S) pieces.push([]);
    pieces.at(-1).push([row[LON], row[LAT]]);
    before = row[AT];
  }
  if (place && before !== null && at - before <= GAP_S) pieces.at(-1).push([place.lon, place.lat]);
  return pieces.filter((piece) => piece.length > 1);
}

// The spans of the time line to the second, by vehicle.
function fine(vehicles) {
  const spans = {};
  for (const [id, rows] of Object.entries(vehicles)) {
    spans[id] = [];
    for (const row of rows) {
      const state = row[STATE] === "lost" ? 3 : row[IN_AIR] ? 2 : 1;
      const last = spans[id].at(-1);
      const near = last && row[AT] - last[1] <= (last[2] === 2 ? GAP_S : GROUND_S);
      if (near) last[1] = row[AT];
      if (!near || last[2] !== state) spans[id].push([row[AT], row[AT], state]);
    }
  }
  return spans;
}

export function ago(seconds) {
  const s = Math.max(0, Math.round(seconds));
  const [h, m] = [Math.floor(s / 3600), Math.floor((s % 3600) / 60)];
  return `${[h && `${h} h`, (h || m) && `${m} min`, !h && `${s % 60} s`].filter(Boolean).join(" ")} ago`;
}
