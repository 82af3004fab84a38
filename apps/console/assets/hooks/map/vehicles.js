// The vehicles: symbols turned by their heading, a line towards their course, names. One update of one source for each push.
import { collection, destination, feature } from "./geo.js";
import { FONT } from "./style.js";
import { provideSymbols, redrawSymbols, symbolName } from "./symbols.js";

const LOOKAHEAD_S = 10; // of the course line
const WORDS = { failsafe: "! FAILSAFE", stale: "STALE", lost: "LOST" };

export class Vehicles {
  constructor(map, colours) {
    this.map = map;
    this.selected = new Set();
    this.colours = colours;
    provideSymbols(map, colours);
    map.addSource("vehicles", { type: "geojson", data: collection(), buffer: 64 });
    for (const layer of layers(colours())) map.addLayer(layer);
  }

  select(fleet, ids) {
    this.selected = new Set(ids);
    this.draw(fleet);
  }

  draw(fleet) {
    const features = [];
    for (const vehicle of fleet.values()) {
      const selected = this.selected.has(vehicle.id);
      const { id, position, heading, state, height } = vehicle;
      const below = [WORDS[state], vehicle.inAir && height != null ? `${Math.round(height)} m` : null].filter(Boolean);
      features.push(
        feature("Point", position, {
          id, selected, state,
          symbol: symbolName(vehicle.kind, state),
          heading: heading ?? 0,
          text: below.length ? `${id}\n${below.join(" · ")}` : id,
          // The selected ones and those in trouble are on top.
          order: (selected ? 10 : 0) + (state === "disarmed" ? 0 : 1),
        }),
      );
      if (vehicle.speed > 0.5 && vehicle.course != null && state !== "lost") {
        features.push(feature("LineString", [position, destination(position, vehicle.course, vehicle.speed * LOOKAHEAD_S)]));
      }
    }
    this.map.getSource("vehicles").setData(collection(features));
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
    for (const layer of layers(this.colours())) {
      for (const [name, value] of Object.entries(layer.paint)) this.map.setPaintProperty(layer.id, name, value);
    }
  }
}

// Applies a payload (README) to the vehicles by id; with `all`, others are gone.
export function update(fleet, { all, vehicles, gone }) {
  if (all) fleet.clear();
  for (const id of gone ?? []) fleet.delete(id);
  for (const row of vehicles) fleet.set(row[0], read(row));
}

function read([id, lat, lon, heading, course, speed, height, kind, state, inAir]) {
  return { id, position: [lon, lat], heading, course, speed, height, kind, state, inAir };
}

function layers(c) {
  const common = { source: "vehicles", filter: ["==", ["geometry-type"], "Point"] };
  return [
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
      paint: {},
    },
    {
      id: "vehicles-name", type: "symbol", ...common,
      layout: {
        "text-field": ["get", "text"], "text-font": FONT, "text-size": 12, "text-anchor": "top", "text-offset": [0, 1.6],
        "symbol-sort-key": ["-", ["get", "order"]],
      },
      paint: { "text-color": c.text, "text-halo-color": c.halo, "text-halo-width": 2 },
    },
  ];
}
