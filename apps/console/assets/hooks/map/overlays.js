// What belongs to vehicles and to the gateway: homes, missions, fences and rally points of vehicles, the policy's zones, range rings,
// the place that a vehicle was told to go to, and what a sheet prepares. One source.
import { circle, collection, continuous, destination, feature, metresText } from "./geo.js";
import { along, FONT, label, repaint } from "./layers.js";

const RINGS = 3;
const RING_APART = 90; // pixels
const MOST_RINGED = 3; // vehicles

export class Overlays {
  constructor(map, colours) {
    this.map = map;
    this.colours = colours;
    this.parts = { homes: [], plans: [], zones: [], rings: [], target: [], preview: [] };
    this.ringed = null;
    map.addSource("overlays", { type: "geojson", data: collection() });
    for (const layer of layers(colours())) map.addLayer(layer);
    map.on("zoomend", () => this.ringed && this.rings(this.ringed));
  }

  set(part, features) {
    this.parts[part] = features;
    this.map.getSource("overlays").setData(collection(Object.values(this.parts).flat()));
  }

  // [[lat, lon], …]
  homes(homes) {
    this.set("homes", homes.map(([lat, lon]) => feature("Point", [lon, lat], { kind: "home", text: "H" })));
  }

  // [{vehicle, mission: [[lat, lon, number]], current, fences: [...], rally: [[lat, lon]]}, …]
  plans(plans) {
    this.set("plans", plans.flatMap(planFeatures));
  }

  // [{kind, name, rings: [[[lat, lon], …], …]}, …] of the gateway's policy; the first ring is the border, the others are holes
  zones(zones) {
    const closed = (ring) => [...ring, ring[0]].map(([lat, lon]) => [lon, lat]);
    this.set("zones", zones.map(({ kind, name, rings }) => feature("Polygon", rings.map(closed), { kind, text: name })));
  }

  // [{text, way: [[lat, lon], …], bad}, …]: who goes when and how high, from where it is now
  preview(routes) {
    this.set("preview", routes.flatMap(({ text, way, bad }) => {
      const points = way.map(([lat, lon]) => [lon, lat]);
      return [
        ...(points.length > 1 ? [feature("LineString", continuous(points), { kind: bad ? "conflict" : "way" })] : []),
        feature("Point", points[0], { kind: "preview", text: bad ? `✕ ${text}` : text, bad }),
      ];
    }));
  }

  // `from`: where the vehicle is that may go there. `ring`: {metres, text}.
  target(place, from) {
    if (!place) return this.set("target", []);
    const { text = "", way = "", ring } = place;
    const at = [place.lon, place.lat];
    this.set("target", [
      feature("Point", at, { kind: "target", text }),
      ...(from ? [feature("LineString", continuous([from, at]), { kind: "way", text: way })] : []),
      ...(ring ? [feature("LineString", circle(at, ring.metres), { kind: "ring" }), feature("Point", destination(at, 0, ring.metres), { kind: "ring", text: ring.text })] : []),
    ]);
  }

  // Rings around places at round distances that suit the zoom; null: none.
  rings(places) {
    this.ringed = places;
    if (!places?.length) return this.parts.rings.length && this.set("rings", []);
    const apart = ringDistance(this.map.getZoom(), places[0][1]);
    this.set("rings", places.slice(0, MOST_RINGED).flatMap((place) =>
      Array.from({ length: RINGS }, (_, n) => apart * (n + 1)).flatMap((metres) => [
        feature("LineString", circle(place, metres), { kind: "ring" }),
        feature("Point", destination(place, 0, metres), { kind: "ring", text: metresText(metres) }),
      ]),
    ));
  }

  repaint() {
    repaint(this.map, layers(this.colours()));
  }
}

// 1, 2 or 5 times a power of ten metres.
export function ringDistance(zoom, lat) {
  const pixel = (40075016.7 * Math.cos((lat * Math.PI) / 180)) / (512 * 2 ** zoom);
  const wanted = pixel * RING_APART;
  const power = 10 ** Math.floor(Math.log10(wanted));
  return [1, 2, 5, 10].find((n) => n * power >= wanted) * power;
}

export function zoneFeature({ kind, ring, centre, radius }, properties = {}) {
  const corners = ring ? ring.map(([lat, lon]) => [lon, lat]) : circle([centre[1], centre[0]], radius);
  return feature("Polygon", [ring ? [...corners, corners[0]] : corners], { kind, ...properties });
}

function planFeatures({ mission = [], current, fences = [], rally = [] }) {
  const way = mission.map(([lat, lon]) => [lon, lat]);
  return [
    ...(way.length > 1 ? [feature("LineString", way, { kind: "mission" })] : []),
    ...mission.map(([lat, lon, number]) => feature("Point", [lon, lat], { kind: "waypoint", text: String(number), current: number === current })),
    ...fences.map((fence) => zoneFeature(fence)),
    ...rally.map(([lat, lon]) => feature("Point", [lon, lat], { kind: "rally", text: "R" })),
  ];
}

function layers(c) {
  const is = (...kinds) => ["in", ["get", "kind"], ["literal", kinds]];
  const all = (geometry, ...kinds) => ["all", ["==", ["geometry-type"], geometry], is(...kinds)];
  const marker = (kind, colour) => ({
    id: `overlays-${kind}`, type: "circle", source: "overlays", filter: all("Point", kind), layout: {},
    paint: { "circle-radius": 10, "circle-color": c.halo, "circle-stroke-color": colour, "circle-stroke-width": 2 },
  });
  return [
    {
      id: "overlays-area", type: "fill", source: "overlays", filter: all("Polygon", "inclusion", "exclusion"), layout: {},
      paint: {
        "fill-color": ["match", ["get", "kind"], "exclusion", c.exclusion, c.inclusion],
        "fill-opacity": ["match", ["get", "kind"], "exclusion", 0.18, 0.05],
      },
    },
    ...["inclusion", "exclusion"].map((kind) => ({
      id: `overlays-${kind}`, type: "line", source: "overlays", filter: all("Polygon", kind), layout: {},
      // The one that must not be entered is dashed, so that it is not told by its colour alone.
      paint: { "line-color": c[kind], "line-width": 2, ...(kind === "exclusion" ? { "line-dasharray": [2, 1.5] } : {}) },
    })),
    {
      id: "overlays-ring", type: "line", source: "overlays", filter: all("LineString", "ring"), layout: {},
      paint: { "line-color": c.tool, "line-width": 1, "line-dasharray": [4, 3] },
    },
    {
      id: "overlays-mission", type: "line", source: "overlays", filter: all("LineString", "mission"), layout: { "line-join": "round" },
      paint: { "line-color": c.mission, "line-width": 2 },
    },
    marker("home", c.home),
    marker("rally", c.rally),
    {
      id: "overlays-waypoint", type: "circle", source: "overlays", filter: all("Point", "waypoint"), layout: {},
      paint: {
        "circle-radius": 9, "circle-stroke-color": c.mission, "circle-stroke-width": 2,
        "circle-color": ["case", ["to-boolean", ["get", "current"]], c.mission, c.halo],
      },
    },
    {
      id: "overlays-target", type: "circle", source: "overlays", filter: all("Point", "target"), layout: {},
      paint: { "circle-radius": 9, "circle-color": "rgba(0,0,0,0)", "circle-stroke-color": c.selected, "circle-stroke-width": 4 },
    },
    {
      id: "overlays-way", type: "line", source: "overlays", filter: all("LineString", "way"), layout: {},
      paint: { "line-color": c.selected, "line-width": 2, "line-dasharray": [2, 1] },
    },
    {
      id: "overlays-conflict", type: "line", source: "overlays", filter: all("LineString", "conflict"), layout: {},
      paint: { "line-color": c.exclusion, "line-width": 3 },
    },
    {
      id: "overlays-preview", type: "symbol", source: "overlays", filter: all("Point", "preview"),
      layout: { "text-field": ["get", "text"], "text-font": FONT, "text-size": 14, "text-offset": [0, -1.8], "text-anchor": "bottom", "text-allow-overlap": true },
      paint: { ...label(c), "text-color": ["case", ["to-boolean", ["get", "bad"]], c.exclusion, c.text] },
    },
    {
      id: "overlays-way-text", type: "symbol", source: "overlays", filter: all("LineString", "way"),
      layout: along,
      paint: label(c),
    },
    {
      id: "overlays-text", type: "symbol", source: "overlays", filter: all("Point", "home", "rally", "waypoint"),
      layout: { "text-field": ["get", "text"], "text-font": FONT, "text-size": 11, "text-allow-overlap": true, "text-ignore-placement": true },
      paint: { "text-color": ["case", ["to-boolean", ["get", "current"]], c.halo, c.text] },
    },
    {
      id: "overlays-name", type: "symbol", source: "overlays", filter: ["all", is("ring", "target", "inclusion", "exclusion"), ["has", "text"]],
      layout: { "text-field": ["get", "text"], "text-font": FONT, "text-size": 11, "text-offset": [0, 1], "text-anchor": "top" },
      paint: label(c),
    },
  ];
}
