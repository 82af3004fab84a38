// Shift and a drag of the mouse: the vehicles in the box, to be added, or with Alt or Ctrl removed.

const LEAST_PX = 5; // less is a click

export function box(map, canvas, done) {
  map.boxZoom.disable();
  let from;
  let frame;
  const at = ({ clientX, clientY }) => {
    const { left, top } = canvas.getBoundingClientRect();
    return { x: clientX - left, y: clientY - top };
  };
  const between = (one, other) => ({ left: Math.min(one.x, other.x), top: Math.min(one.y, other.y), right: Math.max(one.x, other.x), bottom: Math.max(one.y, other.y) });
  const end = () => {
    if (!from) return;
    from = undefined;
    frame?.remove();
    frame = undefined;
    map.dragPan.enable();
    window.removeEventListener("keydown", escape, true);
  };
  const escape = (event) => {
    if (event.key !== "Escape") return;
    event.stopPropagation();
    end();
  };
  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 || !event.shiftKey || event.pointerType === "touch") return;
    // The map would be moved by the same drag.
    map.dragPan.disable();
    from = at(event);
    canvas.setPointerCapture(event.pointerId);
    window.addEventListener("keydown", escape, true);
  }, true);
  canvas.addEventListener("pointermove", (event) => {
    if (!from) return;
    const { left, top, right, bottom } = between(from, at(event));
    if (!frame && Math.hypot(right - left, bottom - top) < LEAST_PX) return;
    if (!frame) canvas.append((frame = Object.assign(document.createElement("div"), { className: "map-box" })));
    Object.assign(frame.style, { left: `${left}px`, top: `${top}px`, width: `${right - left}px`, height: `${bottom - top}px` });
  });
  canvas.addEventListener("pointerup", (event) => {
    const drawn = frame && between(from, at(event));
    end();
    if (drawn) done(({ x, y }) => x >= drawn.left && x <= drawn.right && y >= drawn.top && y <= drawn.bottom, event.altKey || event.ctrlKey);
  });
  for (const name of ["pointercancel", "lostpointercapture"]) canvas.addEventListener(name, end);
}
