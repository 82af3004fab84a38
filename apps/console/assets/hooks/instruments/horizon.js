// The artificial horizon: sky and ground turn behind a fixed symbol of the vehicle.
import { element, line, text } from "../../lib/svg.js";

const PER_DEGREE = 4;
const ROLL_MARKS = [-60, -45, -30, -20, -10, 10, 20, 30, 45, 60];

export function horizon({ x, y, width, height, id }) {
  const [cx, cy] = [x + width / 2, y + height / 2];
  const far = 1000;
  const world = element("g", {},
    element("rect", { x: -far, y: -far, width: 2 * far, height: far, class: "pfd-sky" }),
    element("rect", { x: -far, y: 0, width: 2 * far, height: far, class: "pfd-ground" }),
    line(-far, 0, far, 0, "pfd-horizon"));

  for (let degrees = -90; degrees <= 90; degrees += 5) {
    if (degrees === 0) continue;
    const [half, at] = [degrees % 10 === 0 ? 32 : 16, -degrees * PER_DEGREE];
    world.append(line(-half, at, half, at, "pfd-ladder"));
    if (degrees % 10 === 0) {
      world.append(text(-half - 12, at + 4, "pfd-mark", String(Math.abs(degrees))), text(half + 12, at + 4, "pfd-mark", String(Math.abs(degrees))));
    }
  }

  const radius = height / 2 - 12;
  const pointer = element("path", { d: `M 0 ${-radius + 2} l -7 12 h 14 z`, class: "pfd-pointer" });
  const scale = element("g", { transform: `translate(${cx} ${cy})` },
    element("path", { d: `M 0 ${-radius} l -6 -10 h 12 z`, class: "pfd-zero" }), pointer,
    ...ROLL_MARKS.map((degrees) => {
      const mark = line(0, -radius, 0, -radius - (degrees % 30 === 0 ? 11 : 7), "pfd-roll");
      mark.setAttribute("transform", `rotate(${degrees})`);
      return mark;
    }));

  const symbol = element("path", {
    d: `M ${cx - 62} ${cy} h 34 l 12 11 M ${cx + 62} ${cy} h -34 l -12 11 M ${cx - 3} ${cy} h 6`, class: "pfd-vehicle",
  });

  const node = element("g", {},
    element("clipPath", { id }, element("rect", { x, y, width, height, rx: 10 })),
    element("g", { "clip-path": `url(#${id})` }, world, scale, symbol));

  function show(roll, pitch) {
    const known = roll !== null && pitch !== null;
    node.classList.toggle("pfd-unknown", !known);
    if (!known) return;
    world.setAttribute("transform", `translate(${cx} ${cy}) rotate(${-roll}) translate(0 ${pitch * PER_DEGREE})`);
    pointer.setAttribute("transform", `rotate(${-roll})`);
  }

  return { node, show };
}
