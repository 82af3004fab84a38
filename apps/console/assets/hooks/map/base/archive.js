// Tiles of one PMTiles file: npm's pmtiles reads the ranges that the map needs. `described` gives what style.js draws.
import { npm } from "../npm.js";

// Of the file's tiles: 1 are vectors, the others images.
const TYPES = { 1: "vector", 2: "raster", 3: "raster", 4: "raster", 5: "raster" };
let protocol; // one for all maps of the page

export async function described(tiles, { addProtocol }) {
  if (!tiles.archive) return tiles;
  try {
    protocol ??= register(addProtocol);
    const { PMTiles } = await script("pmtiles/pmtiles.js");
    const url = new URL(tiles.archive, location.href).href;
    const file = new PMTiles(url);
    (await protocol).add(file);
    const found = await contents(file);
    return { ...tiles, ...found, attribution: tiles.attribution ?? found.attribution, url: `pmtiles://${url}/{z}/{x}/{y}` };
  } catch (error) {
    console.warn("map: the tiles cannot be read:", error?.message ?? error);
    return null;
  }
}

async function register(addProtocol) {
  const { Protocol } = await script("pmtiles/pmtiles.js");
  const created = new Protocol();
  addProtocol("pmtiles", created.tile);
  return created;
}

async function contents(file) {
  const { tileType, minZoom, maxZoom, minLon, minLat, maxLon, maxLat } = await file.getHeader();
  const type = TYPES[tileType];
  if (!type) throw new Error("their type is unknown");
  const metadata = await file.getMetadata();
  const layers = type === "vector" ? (metadata?.vector_layers ?? []).map(({ id }) => id) : [];
  // Writers put links into it.
  const attribution = new DOMParser().parseFromString(`${metadata?.attribution ?? ""}`, "text/html").body.textContent.slice(0, 200);
  // Many writers omit the bounds.
  const bounds = minLon < maxLon && minLat < maxLat ? [minLon, minLat, maxLon, maxLat] : null;
  return { type, layers, attribution, minzoom: minZoom, maxzoom: maxZoom, bounds };
}

// The package sets a global; it is not a module.
const script = (path) =>
  globalThis.pmtiles ??
  new Promise((resolve, reject) => {
    const element = Object.assign(document.createElement("script"), { src: npm(path) });
    element.onload = () => resolve(globalThis.pmtiles);
    element.onerror = () => reject(new Error(`${path} cannot be loaded`));
    document.head.append(element);
  });
