// Draws a plan and its handles: a click adds, dragging a handle moves it, dragging the middle of a leg or edge inserts. What is
// changed is told to the server, which keeps the plan and sends it back.
import { collection, destination, distance, feature } from "../geo.js";
import { FONT, repaint } from "../layers.js";
import { zoneFeature } from "../overlays.js";

const EMPTY = { items: [], zones: [], corners: [], rally: [], home: null, part: "mission" };
const REACH = 12; // pixels

export class PlanEditor {
  constructor(map, colours, push) {
    this.map = map;
    this.colours = colours;
    this.push = push;
    this.plan = EMPTY;
    this.enabled = false;
    map.addSource("plan", { type: "geojson", data: collection() });
    for (const layer of layers(colours())) map.addLayer(layer);
    for (const event of ["mousedown", "touchstart"]) map.on(event, (down) => this.grab(down));
    for (const event of ["mousemove", "touchmove"]) map.on(event, (move) => this.drag(move));
    for (const event of ["mouseup", "touchend", "touchcancel"]) map.on(event, (up) => this.drop(up));
  }

  // `plan`: see the README. While a handle is dragged, the plan of the server waits.
  show(plan) {
    if (this.held) this.next = plan;
    else {
      this.plan = { ...EMPTY, ...plan };
      this.draw();
    }
  }

  enable(enabled) {
    if (enabled === this.enabled) return;
    this.enabled = enabled;
    this.held = null;
    this.draw();
  }

  // Every place of the plan, for a view that shows all of it.
  positions() {
    const { items, zones, rally } = this.plan;
    return [...items, ...rally, ...zones.flatMap((zone) => zone.ring?.map(([lat, lon]) => ({ lat, lon })) ?? [{ lat: zone.centre[0], lon: zone.centre[1] }])]
      .filter(({ lat }) => lat != null).map(({ lat, lon }) => [lon, lat]);
  }

  // True if the click was for the editor.
  clicked(point, lngLat) {
    const handle = this.handleAt(point);
    if (handle?.part === "corners") this.push("close_zone", {});
    else if (handle && !handle.middle) this.push("plan_pick", handle);
    else this.add(lngLat);
    return true;
  }

  add({ lng, lat }) {
    this.push("plan_add", { lat, lon: lng });
  }

  handleAt({ x, y }) {
    const found = this.map.queryRenderedFeatures([[x - REACH, y - REACH], [x + REACH, y + REACH]], { layers: ["plan-handle", "plan-middle"] });
    if (found.length === 0) return null;
    const { part, index, corner, middle } = (found.find(({ properties }) => !properties.middle) ?? found[0]).properties;
    return { part, index, ...(corner == null ? {} : { corner }), ...(middle ? { middle: true } : {}) };
  }

  grab(down) {
    if (!this.enabled || down.originalEvent.button > 0 || down.points?.length > 1) return;
    const handle = this.handleAt(down.point);
    if (!handle || handle.part === "corners") return;
    down.preventDefault();
    this.held = { ...handle, from: down.point, moved: false };
  }

  drag({ point, lngLat }) {
    if (!this.held) return;
    if (!this.held.moved && Math.hypot(point.x - this.held.from.x, point.y - this.held.from.y) < 4) return;
    if (!this.held.moved && this.held.middle) this.plan = inserted(this.plan, this.held, lngLat);
    this.held.moved = true;
    this.held.at = lngLat;
    this.plan = moved(this.plan, this.held, lngLat);
    this.draw();
  }

  drop() {
    const { held } = this;
    if (!held) return;
    this.held = null;
    if (held.moved) {
      const { part, index, corner, middle } = held;
      this.push(middle ? "plan_insert" : "plan_move", { part, index, ...(corner == null ? {} : { corner }), lat: held.at.lat, lon: held.at.lng });
    }
    if (this.next) this.show(this.next);
    this.next = null;
  }

  draw() {
    this.map.getSource("plan").setData(collection([...shapes(this.plan), ...(this.enabled ? handles(this.plan) : [])]));
  }

  repaint() {
    repaint(this.map, layers(this.colours()));
  }
}

const at = ({ lat, lon }) => [lon, lat];
const middle = (a, b) => [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
const replaced = (list, index, value) => list.map((old, n) => (n === index ? value : old));
const spliced = (list, index, value) => [...list.slice(0, index), value, ...list.slice(index)];

// The plan with a handle at another place.
export function moved(plan, { part, index, corner }, { lng, lat }) {
  if (part === "home") return { ...plan, home: { ...plan.home, lat, lon: lng } };
  if (part === "mission") return { ...plan, items: replaced(plan.items, index, { ...plan.items[index], lat, lon: lng }) };
  if (part === "rally") return { ...plan, rally: replaced(plan.rally, index, { ...plan.rally[index], lat, lon: lng }) };
  const zone = plan.zones[index];
  if (zone.ring) return { ...plan, zones: replaced(plan.zones, index, { ...zone, ring: replaced(zone.ring, corner, [lat, lng]) }) };
  const changed = corner === 1 ? { radius: distance([zone.centre[1], zone.centre[0]], [lng, lat]) } : { centre: [lat, lng] };
  return { ...plan, zones: replaced(plan.zones, index, { ...zone, ...changed }) };
}

// The plan with a further handle before the one of that number.
export function inserted(plan, { part, index, corner }, { lng, lat }) {
  if (part === "mission") return { ...plan, items: spliced(plan.items, index, { lat, lon: lng, text: "+" }) };
  const zone = plan.zones[index];
  return { ...plan, zones: replaced(plan.zones, index, { ...zone, ring: spliced(zone.ring, corner, [lat, lng]) }) };
}

function shapes({ items, zones, corners, rally, home }) {
  const way = [...(home ? [at(home)] : []), ...items.filter(({ lat }) => lat != null).map(at)];
  const problems = items.flatMap((item, n) => (item.problem && item.lat != null ? [feature("Point", at(item), { shape: "problem", index: n })] : []));
  return [
    ...zones.map((zone) => zoneFeature(zone, { shape: "zone", picked: zone.picked ?? false })),
    ...(way.length > 1 ? [feature("LineString", way, { shape: "way" })] : []),
    ...problems,
    ...(corners.length > 1 ? [feature("LineString", corners.map(([lat, lon]) => [lon, lat]), { shape: "open" })] : []),
    ...corners.map(([lat, lon], n) => feature("Point", [lon, lat], { shape: "rally", text: `${n + 1}`, picked: n === 0 })),
    ...items.flatMap((item) => (item.lat == null ? [] : [feature("Point", at(item), { shape: "item", text: item.text ?? "", picked: item.picked ?? false })])),
    ...rally.map((place, n) => feature("Point", at(place), { shape: "rally", text: `R${n + 1}`, picked: place.picked ?? false })),
    ...(home ? [feature("Point", at(home), { shape: "home", text: "H", picked: false })] : []),
  ];
}

// What can be grabbed: everything of the part that is edited.
function handles({ items, zones, corners, rally, home, part }) {
  const handle = (place, properties) => feature("Point", place, { shape: "handle", part, ...properties });
  const between = (place, properties) => feature("Point", place, { shape: "middle", middle: true, part, ...properties });
  if (part === "rally") return rally.map((place, index) => handle(at(place), { index }));
  if (part === "mission") {
    const placed = items.flatMap((item, index) => (item.lat == null ? [] : [{ item, index }]));
    return [
      ...placed.map(({ item, index }) => handle(at(item), { index })),
      ...placed.slice(1).map(({ item, index }, n) => between(middle(at(placed[n].item), at(item)), { index })),
      ...(home ? [handle(at(home), { part: "home", index: 0 })] : []),
    ];
  }
  // A click on the first corner closes the zone that is being drawn; until then the others stand back.
  if (corners.length > 2) return [feature("Point", [corners[0][1], corners[0][0]], { shape: "handle", part: "corners", index: 0 })];
  if (corners.length > 0) return [];
  return zones.flatMap(({ ring, centre, radius }, index) => {
    if (!ring) {
      const place = [centre[1], centre[0]];
      return [handle(place, { index, corner: 0 }), handle(destination(place, 90, radius), { index, corner: 1 })];
    }
    const corners = ring.map(([lat, lon]) => [lon, lat]);
    return corners.flatMap((corner, n) => [
      handle(corner, { index, corner: n }),
      between(middle(corner, corners[(n + 1) % corners.length]), { index, corner: n + 1 }),
    ]);
  });
}

function layers(c) {
  const shape = (name) => ["==", ["get", "shape"], name];
  const zone = (kind) => ["all", shape("zone"), ["==", ["get", "kind"], kind]];
  const marker = (name, colour, radius) => ({
    id: `plan-${name}`, type: "circle", source: "plan", filter: shape(name), layout: {},
    paint: {
      "circle-radius": radius, "circle-color": ["case", ["get", "picked"], colour, c.halo],
      "circle-stroke-color": colour, "circle-stroke-width": 2,
    },
  });
  return [
    {
      id: "plan-area", type: "fill", source: "plan", filter: shape("zone"), layout: {},
      paint: { "fill-color": ["match", ["get", "kind"], "exclusion", c.exclusion, c.inclusion], "fill-opacity": ["case", ["get", "picked"], 0.25, 0.12] },
    },
    { id: "plan-inclusion", type: "line", source: "plan", filter: zone("inclusion"), layout: {}, paint: { "line-color": c.inclusion, "line-width": 2 } },
    { id: "plan-exclusion", type: "line", source: "plan", filter: zone("exclusion"), layout: {}, paint: { "line-color": c.exclusion, "line-width": 2, "line-dasharray": [2, 1.5] } },
    { id: "plan-open", type: "line", source: "plan", filter: shape("open"), layout: { "line-join": "round" }, paint: { "line-color": c.tool, "line-width": 2, "line-dasharray": [1, 1] } },
    { id: "plan-way", type: "line", source: "plan", filter: shape("way"), layout: { "line-join": "round" }, paint: { "line-color": c.mission, "line-width": 3 } },
    { id: "plan-problem", type: "circle", source: "plan", filter: shape("problem"), layout: {}, paint: { "circle-radius": 17, "circle-color": c.problem, "circle-opacity": 0.5 } },
    marker("home", c.home, 10),
    marker("rally", c.rally, 11),
    marker("item", c.mission, 11),
    {
      id: "plan-text", type: "symbol", source: "plan", filter: ["in", ["get", "shape"], ["literal", ["item", "rally", "home"]]],
      layout: { "text-field": ["get", "text"], "text-font": FONT, "text-size": 11, "text-allow-overlap": true, "text-ignore-placement": true },
      paint: { "text-color": ["case", ["get", "picked"], c.halo, c.text] },
    },
    {
      id: "plan-middle", type: "circle", source: "plan", filter: shape("middle"), layout: {},
      paint: { "circle-radius": 5, "circle-color": c.halo, "circle-stroke-color": c.tool, "circle-stroke-width": 1.5, "circle-opacity": 0.8 },
    },
    {
      id: "plan-handle", type: "circle", source: "plan", filter: shape("handle"), layout: {},
      paint: { "circle-radius": 13, "circle-color": "rgba(0,0,0,0)", "circle-stroke-color": c.tool, "circle-stroke-width": 1 },
    },
  ];
}
