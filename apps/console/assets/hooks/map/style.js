// The map's style: land, borders, own tiles where configured, graticule. It needs no network; labels are drawn with the fonts of
// this machine. Colours are the custom properties of css/map.css, so that they follow the page's theme.
import { color } from "../../lib/theme.js";
import { collection } from "./geo.js";
import { TAG_COLOURS } from "./tags.js";

// Families of whichever this machine has.
export const FONT = ["Segoe UI", "Roboto", "Noto Sans", "Liberation Sans", "DejaVu Sans", "sans-serif"];

const COLOURS = [
  "water", "land", "coast", "border", "grid", "text", "halo", "armed", "disarmed", "stale", "lost", "failsafe", "selected", "track",
  "course", "home", "mission", "inclusion", "exclusion", "rally", "tool", "problem",
  ...Array.from({ length: TAG_COLOURS }, (_, n) => `tag-${n}`),
];

export const colours = () => Object.fromEntries(COLOURS.map((name) => [name, color(`--map-${name}`)]));

const source = () => ({ type: "geojson", data: collection() });

const COARSE = 8; // zoom from which the coastlines are beside those of a base map
const ONLY_COARSE = ["coast", "borders"];

// `tiles`: null, or {type: "raster" | "vector", url, minzoom, maxzoom, bounds, layers}; see the README.
export function style(c, tiles) {
  return {
    version: 8,
    transition: { duration: 0, delay: 0 },
    sources: {
      land: { ...source(), tolerance: 0.2 },
      coast: { ...source(), tolerance: 0.2 },
      borders: { ...source(), tolerance: 0.2 },
      graticule: source(),
      ...(tiles ? { tiles: tileSource(tiles) } : {}),
    },
    layers: [
      { id: "water", type: "background", paint: { "background-color": c.water } },
      { id: "land", type: "fill", source: "land", paint: { "fill-color": c.land, "fill-antialias": false } },
      ...(tiles ? tileLayers(c, tiles) : []),
      { id: "coast", type: "line", source: "coast", ...coarse(tiles), paint: { "line-color": c.coast, "line-width": 1 } },
      { id: "borders", type: "line", source: "borders", ...coarse(tiles), paint: { "line-color": c.border, "line-dasharray": [3, 2] } },
      { id: "graticule", type: "line", source: "graticule", paint: { "line-color": c.grid, "line-width": 0.7 } },
      ...["top", "left"].map((edge) => graticuleLabels(c, edge)),
    ],
  };
}

const coarse = (tiles) => (tiles ? { maxzoom: COARSE } : {});

// Other tiles below everything else of a map that is there already.
export function swap(map, c, tiles) {
  for (const { id, source } of map.getStyle().layers) if (source === "tiles") map.removeLayer(id);
  if (map.getSource("tiles")) map.removeSource("tiles");
  for (const id of ONLY_COARSE) map.setLayerZoomRange(id, 0, tiles ? COARSE : 24);
  if (!tiles) return;
  map.addSource("tiles", tileSource(tiles));
  for (const layer of tileLayers(c, tiles)) map.addLayer(layer, "coast");
}

// What a change of the theme sets anew in a map that is there already.
export function repaint(map, c, tiles) {
  for (const layer of style(c, tiles).layers) {
    for (const [name, value] of Object.entries(layer.paint ?? {})) map.setPaintProperty(layer.id, name, value);
  }
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

const tileSource = ({ type, url, minzoom, maxzoom, bounds }) => ({
  type,
  tiles: [url.startsWith("/") ? location.origin + url : url],
  ...(type === "raster" ? { tileSize: 256 } : {}),
  ...(minzoom == null ? {} : { minzoom }),
  ...(maxzoom == null ? {} : { maxzoom }),
  ...(bounds ? { bounds } : {}),
});

// Layers of vector tiles are known by the names that the OpenMapTiles and Protomaps schemas give them; others are drawn as lines.
const FILLS = { earth: "land", land: "land", landcover: "border", landuse: "border", park: "border", water: "water", ocean: "water", building: "coast", buildings: "coast" };

// Of both schemas: a server and a folder do not say which layers their tiles have.
const COMMON = ["earth", "land", "landcover", "landuse", "park", "water", "ocean", "waterway", "transportation", "roads", "building", "buildings", "boundary", "boundaries"];

function tileLayers(c, { type, layers }) {
  if (type === "raster") return [{ id: "tiles", type: "raster", source: "tiles", paint: { "raster-fade-duration": 0 } }];
  return (layers ?? COMMON).map((name) => {
    const layer = { id: `tiles-${name}`, source: "tiles", "source-layer": name };
    const colour = FILLS[name];
    if (!colour) return { ...layer, type: "line", paint: { "line-color": c.coast, "line-width": 1 } };
    const opacity = colour === "land" || colour === "water" ? 1 : 0.35;
    return { ...layer, type: "fill", filter: ["==", ["geometry-type"], "Polygon"], paint: { "fill-color": c[colour], "fill-opacity": opacity } };
  });
}
