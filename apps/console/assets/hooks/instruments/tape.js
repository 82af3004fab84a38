// A tape: a scale that moves behind a fixed window with the current value. Upright for height and speed. The heading's tape is level and has
// its window below, because the numbers are so close together that the window would hide one of them.
import { element, line, put, text } from "../../lib/svg.js";

// Fades the ends of a level tape, where the numbers would be cut otherwise.
function fade(id, box) {
  const stops = [[0, 0], [0.12, 1], [0.88, 1], [1, 0]];
  const gradient = element("linearGradient", { id: `${id}-fade` },
    ...stops.map(([offset, opacity]) => element("stop", { offset, "stop-color": "#ffffff", "stop-opacity": opacity })));
  return [gradient, element("mask", { id: `${id}-mask`, maskUnits: "userSpaceOnUse", ...box }, element("rect", { ...box, fill: `url(#${id}-fade)` }))];
}

// `step`: between two marks, `every`: each so many marks has a number, `pixels`: of one unit, `side`: where the numbers' tape points to.
export function tape({ x, y, width, height, step, every, pixels, level = false, side = "right", label = String, value = String, id }) {
  const length = level ? width : height;
  const count = Math.ceil(length / (step * pixels) / 2) + every;
  const [cx, cy] = [x + width / 2, y + height / 2];

  const marks = [];
  const moving = element("g");
  for (let i = -count; i <= count; i += 1) {
    const number = text(0, 0, level ? "pfd-number pfd-middle" : `pfd-number pfd-${side}`);
    const tick = line(0, 0, 0, 0, "pfd-tick");
    const mark = element("g", {}, tick, number);
    marks.push({ i, mark, tick, number });
    moving.append(mark);
  }

  const windowAt = level ? y + height + 4 : cy - 13;
  const edge = side === "right" ? x + width : x;
  const inward = side === "right" ? -1 : 1;
  const shown = text(cx, windowAt + 18, "pfd-value pfd-middle", "–");
  const box = element("rect", {
    x: level ? cx - 26 : x + 1, y: windowAt, width: level ? 52 : width - 2, height: 26, rx: 4, class: "pfd-box",
  });
  const faded = element("g", level ? { mask: `url(#${id}-mask)` } : {}, moving);

  const node = element("g", {},
    element("clipPath", { id }, element("rect", { x, y, width, height, rx: 6 })),
    element("rect", { x, y, width, height, rx: 6, class: "pfd-tape" }),
    element("g", { "clip-path": `url(#${id})` }, faded), box,
    ...(level ? [...fade(id, { x, y, width, height }), element("path", { d: `M ${cx} ${y + height - 6} l -7 10 h 14 z`, class: "pfd-pointer" })] : []), shown);

  let base = null;

  function number(of) {
    base = of;
    for (const { i, tick, number } of marks) {
      const n = of + i;
      const major = n % every === 0;
      const at = i * step * pixels;
      const [length_, place] = [major ? 12 : 6, major ? label(n * step) : ""];
      if (level) {
        for (const [key, v] of [["x1", at], ["x2", at], ["y1", y], ["y2", y + length_]]) tick.setAttribute(key, v);
        number.setAttribute("x", at);
        number.setAttribute("y", y + 25);
      } else {
        for (const [key, v] of [["y1", -at], ["y2", -at], ["x1", edge], ["x2", edge + inward * length_]]) tick.setAttribute(key, v);
        number.setAttribute("x", edge + inward * 16);
        number.setAttribute("y", -at + 4);
      }
      put(number, place);
    }
  }

  function show(now) {
    node.classList.toggle("pfd-unknown", now === null);
    if (now === null) return put(shown, "–");
    const of = Math.round(now / step);
    if (of !== base) number(of);
    const rest = (now - of * step) * pixels;
    moving.setAttribute("transform", level ? `translate(${cx - rest} 0)` : `translate(0 ${cy + rest})`);
    put(shown, value(now));
  }

  return { node, show };
}
