// Parallels and meridians of what is in view, at a distance that suits the zoom, and their labels at the left and upper edge. Pure.
import { collection, feature } from "../geo.js";

// In seconds of arc: 30 degrees to 1 second.
const STEPS = [108000, 54000, 36000, 18000, 7200, 3600, 1800, 600, 300, 120, 60, 30, 10, 5, 2, 1];
const APART = 110; // pixels
const MOST = 60; // lines in one direction; a tall narrow view must not draw thousands
const POLE = 85;

export function step(zoom) {
  const pixels = (512 * 2 ** zoom) / 360 / 3600;
  return STEPS.findLast((seconds) => seconds * pixels >= APART) ?? STEPS[0];
}

// `bounds`: {west, south, east, north} in degrees.
export function graticule({ west, south, east, north }, zoom) {
  const seconds = step(zoom);
  const [bottom, top] = [Math.max(south, -POLE), Math.min(north, POLE)];
  const lines = [];
  const labels = [];

  for (const at of multiples(west, east, seconds)) {
    const lon = at / 3600;
    lines.push(feature("LineString", [[lon, bottom], [lon, top]]));
    labels.push(feature("Point", [lon, top], { text: angle(wrapped(at), "E", "W"), edge: "top" }));
  }
  for (const at of multiples(bottom, top, seconds)) {
    const lat = at / 3600;
    lines.push(feature("LineString", [[west, lat], [east, lat]]));
    labels.push(feature("Point", [west, lat], { text: angle(at, "N", "S"), edge: "left" }));
  }
  return collection([...lines, ...labels]);
}

function multiples(from, to, seconds) {
  const first = Math.ceil((from * 3600) / seconds);
  const last = Math.min(Math.floor((to * 3600) / seconds), first + MOST);
  return Array.from({ length: Math.max(0, last - first + 1) }, (_, n) => (first + n) * seconds);
}

const wrapped = (seconds) => ((((seconds + 648000) % 1296000) + 1296000) % 1296000) - 648000;

// 45°, 45°30′, 45°30′15″ with the letter of the hemisphere.
export function angle(seconds, positive, negative) {
  const total = Math.abs(Math.round(seconds));
  const parts = [`${Math.floor(total / 3600)}°`];
  if (total % 3600) parts.push(`${String(Math.floor((total % 3600) / 60)).padStart(2, "0")}′`);
  if (total % 60) parts.push(`${String(total % 60).padStart(2, "0")}″`);
  const letter = total === 0 || total === 648000 ? "" : seconds > 0 ? positive : negative;
  return parts.join("") + letter;
}
