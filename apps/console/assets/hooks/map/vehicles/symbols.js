// The symbols of vehicles, drawn once for each type, state and theme. The state is in the shape, too, because colours are
// not told apart by everybody and in every light:
//
//   disarmed  outline         armed     filled        failsafe  filled, with ! beside it
//   stale     dashed outline  lost      thin outline, crossed out
//
// What is armed or disarmed may have the colour of its tag; a disc is a cluster.
//
// Symbols point to the north; the map turns them.

const SIZE = 40; // CSS pixels
const RATIO = 2;

const KINDS = {
  copter: (p) => {
    for (const [x, y] of [[-9, -9], [9, -9], [-9, 9], [9, 9]]) circle(p, x, y, 5);
    polygon(p, [[0, -13], [6, -2], [5, 7], [-5, 7], [-6, -2]]);
  },
  plane: (p) =>
    polygon(p, [[0, -16], [2.5, -11], [2.5, -4], [16, 3], [16, 7], [2.5, 4], [2, 11], [6, 14], [6, 16], [-6, 16], [-6, 14], [-2, 11], [-2.5, 4], [-16, 7], [-16, 3], [-2.5, -4], [-2.5, -11]]),
  vtol: (p) => {
    polygon(p, [[0, -16], [3, -5], [16, 0], [16, 5], [3, 4], [2, 12], [6, 15], [-6, 15], [-2, 12], [-3, 4], [-16, 5], [-16, 0], [-3, -5]]);
    for (const [x, y] of [[-9, -7], [9, -7], [-9, 9], [9, 9]]) circle(p, x, y, 3.5);
  },
  rover: (p) => {
    polygon(p, [[0, -15], [7, -7], [7, 12], [-7, 12], [-7, -7]]);
    for (const [x, y] of [[-10, -6], [10, -6], [-10, 7], [10, 7]]) polygon(p, [[x - 2, y - 4], [x + 2, y - 4], [x + 2, y + 4], [x - 2, y + 4]]);
  },
  boat: (p) => polygon(p, [[0, -16], [7, -5], [7, 10], [4, 14], [-4, 14], [-7, 10], [-7, -5]]),
  sub: (p) => {
    p.ellipse(0, 0, 6, 14, 0, 0, 2 * Math.PI);
    p.closePath();
    polygon(p, [[-9, 11], [9, 11], [9, 14], [-9, 14]]);
  },
  cluster: (p) => circle(p, 0, 0, 17),
  unknown: (p) => polygon(p, [[0, -14], [10, 12], [0, 7], [-10, 12]]),
};
const LIKE = { blimp: "sub", balloon: "unknown", rocket: "unknown", kite: "plane", flapping_wing: "plane", parafoil: "plane", spacecraft: "unknown", tracker: "unknown" };

export const STATES = ["disarmed", "armed", "failsafe", "stale", "lost"];

// `tag`: the number of a tag's colour.
export const symbolName = (kind, state, tag) =>
  `vehicle-${KINDS[kind] ? kind : (LIKE[kind] ?? "unknown")}-${state}${tag === undefined || !["armed", "disarmed"].includes(state) ? "" : `-${tag}`}`;

// Draws what the style asks for and does not have yet; `colours()` gives the theme's.
export function provideSymbols(map, colours) {
  map.setMissingStyleImageResolver((id) => {
    const [prefix, ...what] = id.split("-");
    if (prefix === "vehicle") map.addImage(id, image(colours(), ...what), { pixelRatio: RATIO });
  });
}

export function redrawSymbols(map, colours) {
  for (const id of map.listImages()) {
    const [prefix, ...what] = id.split("-");
    if (prefix === "vehicle") map.updateImage(id, image(colours(), ...what));
  }
}

function image(c, kind, state, tag) {
  const colour = c[tag === undefined ? state : `tag-${tag}`];
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = SIZE * RATIO;
  const p = canvas.getContext("2d");
  p.scale(RATIO, RATIO);
  p.translate(SIZE / 2, SIZE / 2);
  p.lineJoin = "round";

  const shape = new Path2D();
  KINDS[kind](shape);
  p.strokeStyle = c.halo;
  p.lineWidth = 5;
  p.stroke(shape);
  const filled = state === "armed" || state === "failsafe";
  // The number of a cluster stands on it.
  p.fillStyle = filled && kind !== "cluster" ? colour : c.halo;
  p.fill(shape);
  p.setLineDash(state === "stale" ? [3, 2] : []);
  p.strokeStyle = filled && kind !== "cluster" ? c.text : colour;
  p.lineWidth = kind === "cluster" && filled ? 5 : filled || state === "lost" ? 1 : 2.5;
  p.stroke(shape);
  p.setLineDash([]);

  if (state === "lost") {
    strokes(p, c.halo, 6);
    strokes(p, c.lost, 3);
  }
  return p.getImageData(0, 0, canvas.width, canvas.height);
}

function strokes(p, colour, width) {
  p.strokeStyle = colour;
  p.lineWidth = width;
  p.beginPath();
  p.moveTo(-12, -12);
  p.lineTo(12, 12);
  p.moveTo(12, -12);
  p.lineTo(-12, 12);
  p.stroke();
}

function circle(path, x, y, radius) {
  path.moveTo(x + radius, y);
  path.arc(x, y, radius, 0, 2 * Math.PI);
}

function polygon(path, corners) {
  corners.forEach(([x, y], n) => (n === 0 ? path.moveTo(x, y) : path.lineTo(x, y)));
  path.closePath();
}
