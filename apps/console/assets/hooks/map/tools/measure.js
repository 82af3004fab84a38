// Distances along a line that is clicked, with the direction and length of each leg.
import { bearing, collection, distance, feature, metresText } from "../geo.js";
import { along, label, repaint } from "../layers.js";

export class Measure {
  constructor(map, colours, say) {
    this.map = map;
    this.colours = colours;
    this.say = say;
    this.points = [];
    map.addSource("measure", { type: "geojson", data: collection() });
    for (const layer of layers(colours())) map.addLayer(layer);
  }

  add(point) {
    this.points.push(point);
    this.draw();
  }

  removeLast() {
    this.points.pop();
    this.draw();
  }

  clear() {
    this.points = [];
    this.draw();
  }

  draw() {
    const features = this.points.map((point) => feature("Point", point));
    let total = 0;
    for (let n = 1; n < this.points.length; n++) {
      const [from, to] = [this.points[n - 1], this.points[n]];
      const metres = distance(from, to);
      total += metres;
      const text = `${metresText(metres)} ${Math.round(bearing(from, to)) % 360}°`;
      features.push(feature("LineString", [from, to], { text }));
    }
    this.map.getSource("measure").setData(collection(features));
    this.say(this.points.length > 1 ? `Distance: ${metresText(total)}` : "Click points on the map, or press Enter to take its centre. Escape ends.");
  }

  repaint() {
    repaint(this.map, layers(this.colours()));
  }
}

function layers(c) {
  return [
    { id: "measure-line", type: "line", source: "measure", layout: {}, paint: { "line-color": c.tool, "line-width": 2, "line-dasharray": [2, 1] } },
    {
      id: "measure-point", type: "circle", source: "measure", filter: ["==", ["geometry-type"], "Point"], layout: {},
      paint: { "circle-radius": 4, "circle-color": c.tool, "circle-stroke-color": c.halo, "circle-stroke-width": 2 },
    },
    {
      id: "measure-text", type: "symbol", source: "measure", filter: ["==", ["geometry-type"], "LineString"],
      layout: along,
      paint: label(c),
    },
  ];
}
