// The vehicles: symbols turned by their heading, a line towards their course, names; from far, clusters. One update of one source for each
// push, and between them only while something moves on the screen or fades, and the page is seen.
import { ClusterKeys } from "./cluster_keys.js";
import { BELOW, clustered } from "./clusters.js";
import { bounds, collection, destination, feature } from "../geo.js";
import { again, opacity, shown } from "./motion.js";
import { FONT, label, repaint } from "../layers.js";
import { provideSymbols, redrawSymbols, symbolName } from "./symbols.js";
import { tagColours } from "./tags.js";

const LOOKAHEAD_S = 10; // of the course line
const WORDS = { failsafe: "! FAILSAFE", stale: "STALE", lost: "LOST" };
const FRAME_MS = 66;
const SLOW_MS = 100;
const SHARE = 5; // of the time that the map needs to draw, at least so often; a browser without a graphics processor needs long
const still = window.matchMedia("(prefers-reduced-motion: reduce)");

export class Vehicles {
  // `tagged(tags)` is told the numbers of the tags' colours.
  constructor(map, colours, tagged = () => {}) {
    Object.assign(this, { map, colours, tagged, selected: new Set(), fleet: new Map(), tags: new Map(), clusters: [], began: null, ended: 0, took: 0, due: false });
    provideSymbols(map, colours);
    map.addSource("vehicles", { type: "geojson", data: collection(), buffer: 64 });
    for (const layer of layers(colours())) map.addLayer(layer);
    this.keys = new ClusterKeys(map, (members) => this.nearer(members));
    map.on("zoom", () => this.step() !== this.stepped && this.paint());
    // From the data to the picture.
    map.on("render", () => {
      if (this.began === null || !map.isSourceLoaded("vehicles")) return;
      this.ended = performance.now();
      this.took = this.ended - this.began;
      this.began = null;
      if (this.due) this.soon();
    });
    map.on("remove", () => clearTimeout(this.timer));
  }

  select(fleet, ids) {
    this.selected = new Set(ids);
    this.draw(fleet);
  }

  draw(fleet) {
    this.fleet = fleet;
    const tags = tagColours([...fleet.values()].flatMap(({ tag }) => tag ?? []));
    if ([...tags].join() !== [...this.tags].join()) this.tagged(tags);
    this.tags = tags;
    this.soon();
  }

  // One drawing at a time; a page on which that takes long has as long for everything else.
  soon() {
    this.due = true;
    if (this.began !== null) return;
    clearTimeout(this.timer);
    const wait = this.took < SLOW_MS ? 0 : this.ended + this.took - performance.now();
    if (wait <= 0) this.paint();
    else this.timer = setTimeout(() => this.paint(), wait);
  }

  // The zoom as far as clusters depend on it.
  step() {
    return Math.min(BELOW, Math.floor(this.map.getZoom()));
  }

  paint() {
    const now = performance.now();
    this.began ??= now;
    this.due = false;
    const all = [...this.fleet.values()];
    this.stepped = this.step();
    const { singles, clusters } = clustered(all, this.stepped, (vehicle) => this.selected.has(vehicle.id) || vehicle.urgent);
    this.clusters = clusters;
    this.keys.show(clusters);
    const groups = clusters.map(({ position, state, members }, cluster) => {
      const word = WORDS[state];
      return feature("Point", position, { cluster, symbol: symbolName("cluster", state), count: `${members.length}`, text: word ?? "" });
    });
    this.map.getSource("vehicles").setData(collection([...groups, ...singles.flatMap((vehicle) => this.features(vehicle, now))]));
    this.later(all, now);
  }

  features(vehicle, now) {
    const { id, heading, state, height, course, speed, tag, inAir, urgent } = vehicle;
    const selected = this.selected.has(id);
    const position = still.matches ? vehicle.position : shown(vehicle, now);
    const below = [WORDS[state], inAir && height != null ? `${Math.round(height)} m` : null].filter(Boolean);
    const point = feature("Point", position, {
      id, selected, state,
      symbol: symbolName(vehicle.kind, state, this.tags.get(tag)),
      heading: heading ?? 0,
      text: below.length ? `${id}\n${below.join(" · ")}` : id,
      opacity: opacity(vehicle, now),
      // The selected ones are on top, then those in trouble and those in the air; names in the same order.
      order: (selected ? 8 : 0) + (urgent || WORDS[state] ? 4 : 0) + (inAir ? 2 : 0) + (state === "disarmed" ? 0 : 1),
    });
    if (!(speed > 0.5) || course == null || state === "lost") return [point];
    return [point, feature("LineString", [position, destination(position, course, speed * LOOKAHEAD_S)])];
  }

  later(all, now) {
    clearTimeout(this.timer);
    const metres = (78_271.5 * Math.cos((this.map.getCenter().lat * Math.PI) / 180)) / 2 ** this.map.getZoom();
    const wait = again(all, now, still.matches ? Infinity : metres, Math.max(FRAME_MS, SHARE * this.took));
    // The browser asks for no frame of a page that is not seen, and the last one has to be drawn before the next.
    const next = () => requestAnimationFrame(() => this.map.style && (this.map.isSourceLoaded("vehicles") ? this.paint() : this.later(all, now)));
    if (wait !== null) this.timer = setTimeout(next, wait);
  }

  // A cluster at a point of the screen is looked at from nearer.
  open(point) {
    const [found] = this.map.queryRenderedFeatures(point, { layers: ["vehicles-cluster"] });
    const members = found && this.clusters[found.properties.cluster]?.members;
    if (members) this.nearer(members);
    return members !== undefined;
  }

  nearer(members) {
    this.map.fitBounds(bounds(members.map(({ position }) => position)), { padding: 60, maxZoom: 16 });
  }

  // The nearest vehicle to a point of the screen, within a finger's width; null if there is none.
  at({ x, y }, reach = 14) {
    const found = this.map.queryRenderedFeatures([[x - reach, y - reach], [x + reach, y + reach]], { layers: ["vehicles"] });
    const far = (one) => {
      const at = this.map.project(one.geometry.coordinates);
      return Math.hypot(at.x - x, at.y - y);
    };
    return found.sort((a, b) => far(a) - far(b))[0]?.properties.id ?? null;
  }

  repaint() {
    redrawSymbols(this.map, this.colours);
    repaint(this.map, layers(this.colours()));
  }
}

// Applies a payload (README) to the vehicles by id; with `all`, others are gone; with `exact`, they are drawn where they are told to be.
export function update(fleet, { all, vehicles, gone, exact }) {
  if (all) fleet.clear();
  for (const id of gone ?? []) fleet.delete(id);
  const at = exact ? Infinity : performance.now();
  for (const row of vehicles) fleet.set(row[0], { ...read(row), at });
}

function read([id, lat, lon, heading, course, speed, height, kind, state, inAir, tag, urgent]) {
  return { id, position: [lon, lat], heading, course, speed, height, kind, state, inAir, tag, urgent: urgent || state === "failsafe" || state === "lost" };
}

function layers(c) {
  const common = { source: "vehicles", filter: ["has", "id"] };
  const name = { "text-font": FONT, "text-size": 12, "text-anchor": "top", "text-offset": [0, 1.6] };
  const text = label(c);
  return [
    {
      id: "vehicles-cluster", type: "symbol", source: "vehicles", filter: ["has", "cluster"],
      layout: {
        ...name, "icon-image": ["get", "symbol"], "icon-allow-overlap": true, "text-allow-overlap": true, "text-size": 13, "text-anchor": "center", "text-offset": [0, 0],
        "text-field": ["case", ["==", ["get", "text"], ""], ["get", "count"], ["concat", ["get", "count"], "\n", ["get", "text"]]],
      },
      paint: text,
    },
    {
      id: "vehicles-course", type: "line", source: "vehicles", filter: ["==", ["geometry-type"], "LineString"],
      layout: { "line-cap": "round" },
      paint: { "line-color": c.course, "line-width": 2 },
    },
    {
      id: "vehicles-selected", type: "circle", ...common, filter: ["all", common.filter, ["get", "selected"]],
      layout: {},
      paint: { "circle-radius": 22, "circle-color": "rgba(0,0,0,0)", "circle-stroke-color": c.selected, "circle-stroke-width": 3 },
    },
    {
      id: "vehicles", type: "symbol", ...common,
      layout: {
        "icon-image": ["get", "symbol"], "icon-rotate": ["get", "heading"], "icon-rotation-alignment": "map",
        "icon-allow-overlap": true, "icon-ignore-placement": true, "symbol-sort-key": ["get", "order"],
      },
      paint: { "icon-opacity": ["get", "opacity"] },
    },
    {
      id: "vehicles-name", type: "symbol", ...common,
      layout: { ...name, "text-field": ["get", "text"], "symbol-sort-key": ["-", ["get", "order"]] },
      paint: text,
    },
  ];
}
