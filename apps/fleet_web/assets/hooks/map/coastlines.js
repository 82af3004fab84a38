// Land and borders from npm's world-atlas (Natural Earth, public domain): coarse ones first, fine ones when the view comes closer.
import { collection, continuous, feature } from "./geo.js";
import { npm } from "./npm.js";

const FINE_ZOOM = 4.5;

export class Coastlines {
  constructor(map) {
    this.map = map;
    this.shown = null;
    this.failed = false;
    this.wanted = () => this.show(map.getZoom() >= FINE_ZOOM ? "10m" : "50m");
    map.on("zoomend", this.wanted);
    this.wanted();
  }

  async show(detail) {
    if (this.shown === detail || this.shown === "10m" || this.failed) return;
    this.shown = detail;
    try {
      const { land, coast, borders } = await read(detail);
      // Finer ones may have come meanwhile, or the map may be gone.
      if (this.shown !== detail || !this.map.getSource("land")) return;
      this.map.getSource("land").setData(land);
      this.map.getSource("coast").setData(coast);
      this.map.getSource("borders").setData(borders);
    } catch (error) {
      // Without coastlines the map still has its graticule.
      this.failed = true;
      console.warn("coastlines:", error);
    }
  }
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
  const inland = mesh(atlas, atlas.objects.countries, (a, b) => a !== b).coordinates.map(continuous);
  return {
    land: collection([feature("MultiPolygon", rings.map((polygon) => polygon.map(aroundThePole)))]),
    coast: collection([feature("MultiLineString", rings.flat())]),
    borders: collection([feature("MultiLineString", inland)]),
  };
}

const polygons = ({ geometry: { type, coordinates } }) => (type === "Polygon" ? [coordinates] : coordinates);

// Antarctica's ring goes once around the earth; on a flat map it is closed below the pole.
function aroundThePole(ring) {
  const [[first], [last]] = [ring[0], ring.at(-1)];
  return Math.abs(last - first) < 180 ? ring : [...ring, [last, -90], [first, -90], ring[0]];
}
