// Land and borders from npm's world-atlas (Natural Earth, public domain): coarse ones of the whole earth, and from FINE_ZOOM on fine ones of
// what is around the view. All fine ones at once keep a computer busy for seconds.
import { line, ring } from "./cut.js";
import { collection, continuous, feature } from "../geo.js";
import { npm } from "../npm.js";

const FINE_ZOOM = 4.5;
const MARGIN = 1; // of the view's size, on each side
const LEAST = 2; // degrees

export class Coastlines {
  constructor(map) {
    this.map = map;
    this.read = {}; // what was fetched, by its detail
    this.shown = null;
    this.failed = false;
    map.on("moveend", () => this.show());
    this.show();
  }

  async show() {
    const view = this.view();
    const detail = view.fine ? "10m" : "50m";
    if (this.failed || (this.shown?.detail === detail && (!view.fine || contains(this.shown.box, view)))) return;
    const shown = (this.shown = { detail, box: around(view) });
    try {
      const lines = await (this.read[detail] ??= read(detail));
      // The view may have gone elsewhere meanwhile, or the map may be gone.
      if (this.shown !== shown || !this.map.getSource("land")) return;
      const { land, coast, borders } = view.fine ? cut(lines, shown.box) : lines;
      this.map.getSource("land").setData(collection([feature("MultiPolygon", land)]));
      this.map.getSource("coast").setData(collection([feature("MultiLineString", coast)]));
      this.map.getSource("borders").setData(collection([feature("MultiLineString", borders)]));
    } catch (error) {
      // Without coastlines the map still has its graticule.
      this.failed = true;
      console.warn("coastlines:", error);
    }
  }

  view() {
    const bounds = this.map.getBounds();
    return { west: bounds.getWest(), east: bounds.getEast(), south: bounds.getSouth(), north: bounds.getNorth(), fine: this.map.getZoom() >= FINE_ZOOM };
  }
}

const contains = (box, view) => box.west <= view.west && box.east >= view.east && box.south <= view.south && box.north >= view.north;

function around({ west, south, east, north }) {
  const [wide, high] = [Math.max(LEAST, MARGIN * (east - west)), Math.max(LEAST, MARGIN * (north - south))];
  return { west: west - wide, south: south - high, east: east + wide, north: north + high };
}

// The map repeats the earth, so what is around the view may be there under other longitudes.
function cut({ land, coast, borders }, box) {
  const boxes = [-720, -360, 0, 360, 720].map((turn) => ({ ...box, west: box.west + turn, east: box.east + turn }));
  return {
    land: boxes.flatMap((box) =>
      land.map((polygon) => polygon.map((one) => ring(one, box)).filter(({ length }) => length)).filter(({ length }) => length),
    ),
    coast: boxes.flatMap((box) => coast.flatMap((one) => line(one, box))),
    borders: boxes.flatMap((box) => borders.flatMap((one) => line(one, box))),
  };
}

async function read(detail) {
  const [{ default: toGeoJson }, { default: mesh }, atlas] = await Promise.all([
    import(npm("topojson-client/feature.js")),
    import(npm("topojson-client/mesh.js")),
    fetch(npm(`world-atlas/countries-${detail}.json`)).then((answer) => {
      if (!answer.ok) throw new Error(`HTTP ${answer.status}`);
      return answer.json();
    }),
  ]);
  const rings = toGeoJson(atlas, atlas.objects.land).features.flatMap(polygons).map((polygon) => polygon.map(continuous));
  return {
    land: rings.map((polygon) => polygon.map(aroundThePole)),
    coast: rings.flat(),
    borders: mesh(atlas, atlas.objects.countries, (a, b) => a !== b).coordinates.map(continuous),
  };
}

const polygons = ({ geometry: { type, coordinates } }) => (type === "Polygon" ? [coordinates] : coordinates);

// Antarctica's ring goes once around the earth; on a flat map it is closed below the pole.
function aroundThePole(ring) {
  const [[first], [last]] = [ring[0], ring.at(-1)];
  return Math.abs(last - first) < 180 ? ring : [...ring, [last, -90], [first, -90], ring[0]];
}
