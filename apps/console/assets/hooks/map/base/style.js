// The map's style: land, borders, tiles, graticule. It needs no network; labels are drawn with the font of the pages. Colours are the custom properties of css/map.css, so that they follow the page's theme.
import { color, dark } from "../../../lib/theme.js";
import { collection, feature } from "../geo.js";
import { FONT, label } from "../layers.js";
import { TAG_COLOURS } from "../vehicles/tags.js";

const COLOURS = [
  "water", "land", "coast", "border", "grid", "text", "halo", "armed", "disarmed", "stale", "lost", "failsafe", "selected", "track",
  "course", "home", "mission", "inclusion", "exclusion", "rally", "tool", "problem",
  ...Array.from({ length: TAG_COLOURS }, (_, n) => `tag-${n}`),
];

export const colours = () => Object.fromEntries(COLOURS.map((name) => [name, color(`--map-${name}`)]));

const source = () => ({ type: "geojson", data: collection() });

const COARSE = 8; // zoom from which the coastlines are beside those of a base map
const ONLY_COARSE = ["coast", "borders"];

// `tiles`: null, or {type: "raster" | "vector", url, minzoom, maxzoom, bounds, layers, basemaps, areas}; see the README.
export function style(c, tiles) {
  return {
    version: 8,
    transition: { duration: 0, delay: 0 },
    sources: {
      land: { ...source(), tolerance: 0.2 },
      coast: { ...source(), tolerance: 0.2 },
      borders: { ...source(), tolerance: 0.2 },
      graticule: source(),
      ...(tiles ? { tiles: tileSource(tiles), areas: areaSource(tiles) } : {}),
    },
    layers: [
      { id: "water", type: "background", paint: { "background-color": c.water } },
      { id: "land", type: "fill", source: "land", paint: { "fill-color": c.land, "fill-antialias": false } },
      ...(tiles ? tileLayers(c, tiles) : []),
      { id: "coast", type: "line", source: "coast", ...coarse(tiles), paint: { "line-color": c.coast, "line-width": 1 } },
      { id: "borders", type: "line", source: "borders", ...coarse(tiles), paint: { "line-color": c.border, "line-dasharray": [3, 2] } },
      { id: "graticule", type: "line", source: "graticule", paint: { "line-color": c.grid, "line-width": 0.7 } },
      ...["top", "left"].map((edge) => graticuleLabels(c, edge)),
      ...(tiles ? areaLayers(c) : []),
    ],
  };
}

const coarse = (tiles) => (tiles ? { maxzoom: COARSE } : {});

// Other tiles below everything else of a map that is there already.
export function swap(map, c, tiles) {
  const sources = ["tiles", "areas"];
  for (const { id, source } of map.getStyle().layers) if (sources.includes(source)) map.removeLayer(id);
  for (const name of sources) if (map.getSource(name)) map.removeSource(name);
  for (const id of ONLY_COARSE) map.setLayerZoomRange(id, 0, tiles ? COARSE : 24);
  if (!tiles) return;
  map.addSource("tiles", tileSource(tiles));
  map.addSource("areas", areaSource(tiles));
  for (const layer of tileLayers(c, tiles)) map.addLayer(layer, "coast");
  for (const layer of areaLayers(c)) map.addLayer(layer, "graticule");
}

function graticuleLabels(c, edge) {
  return {
    id: `graticule-${edge}`,
    type: "symbol",
    source: "graticule",
    filter: ["==", ["get", "edge"], edge],
    layout: {
      "text-field": ["get", "text"],
      "text-font": FONT,
      "text-size": 11,
      "text-anchor": edge === "top" ? "top" : "left",
      "text-offset": edge === "top" ? [0, 0.3] : [0.4, 0],
    },
    paint: { "text-color": c.text, "text-halo-color": c.halo, "text-halo-width": 1.5, "text-opacity": 0.8 },
  };
}

// Where all tiles are there without internet: `areas` of the layer, [{box: [west, south, east, north], zoom}].
const areaSource = ({ areas = [] }) => ({
  type: "geojson",
  data: collection(areas.flatMap(({ box: [west, south, east, north], zoom }) => {
    const text = `Prepared to zoom ${zoom}`;
    return [feature("LineString", [[west, south], [east, south], [east, north], [west, north], [west, south]], { text }), feature("Point", [west, north], { text })];
  })),
});

const areaLayers = (c) => [
  { id: "areas", type: "line", source: "areas", filter: ["==", ["geometry-type"], "LineString"], paint: { "line-color": c.tool, "line-width": 1.5, "line-dasharray": [6, 3] } },
  {
    id: "areas-text", type: "symbol", source: "areas", filter: ["==", ["geometry-type"], "Point"],
    layout: { "text-field": ["get", "text"], "text-font": FONT, "text-size": 11, "text-anchor": "bottom-left", "text-offset": [0, -0.2] },
    paint: label(c),
  },
];

const tileSource = ({ type, url, minzoom, maxzoom, bounds }) => ({
  type,
  tiles: [url.startsWith("/") ? location.origin + url : url],
  ...(type === "raster" ? { tileSize: 256 } : {}),
  ...(minzoom == null ? {} : { minzoom }),
  ...(maxzoom == null ? {} : { maxzoom }),
  ...(bounds ? { bounds } : {}),
});

// Fonts of a server in the style of Protomaps. Without such a server MapLibre draws labels with the fonts of the page.
const FONTS = /"Noto Sans (Regular|Medium|Italic|Devanagari Regular v1)"/g;
// Of the OpenMapTiles schema, where nothing says which layers there are: a server and a folder do not.
const OTHERS = ["waterway", "transportation", "building", "boundary"];

// Vectors look as npm's @protomaps/basemaps says (`basemaps`), without its pictures; what its schema does not have is drawn as lines.
function tileLayers(c, { type, layers, basemaps }) {
  // Images are as bright at night.
  const dimmed = { "raster-brightness-max": dark() ? 0.6 : 1, "raster-saturation": dark() ? -0.3 : 0 };
  if (type === "raster") return [{ id: "tiles", type: "raster", source: "tiles", paint: { "raster-fade-duration": 0, ...dimmed } }];
  const drawn = basemaps
    // Water and land as without tiles.
    .layers("tiles", { ...basemaps.namedFlavor(dark() ? "dark" : "light"), water: c.water, earth: c.land }, { lang: navigator.language.slice(0, 2) })
    .filter(({ id, source }) => source && id !== "roads_oneway")
    .map(({ id, layout: { "icon-image": _picture, ...layout } = {}, ...layer }) => ({ ...layer, id: `tiles-${id}`, layout }));
  const known = new Set(drawn.map((layer) => layer["source-layer"]));
  const lines = (layers ?? OTHERS).filter((name) => !known.has(name)).map((name) => ({
    id: `tiles-line-${name}`, type: "line", source: "tiles", "source-layer": name, paint: { "line-color": c.coast, "line-width": 1 },
  }));
  return [...JSON.parse(JSON.stringify(drawn).replaceAll(FONTS, JSON.stringify(FONT).slice(1, -1))), ...lines];
}
