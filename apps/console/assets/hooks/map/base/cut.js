// Cuts rings and lines to a box, {west, south, east, north} in degrees. Pure. What is closed stays closed, along the box's edges;
// that is right for an area, and an edge of the box is out of view.

// A closed ring; [] if nothing of it is in the box.
export function ring(points, { west, south, east, north }) {
  const [[left, bottom], [right, top]] = extent(points);
  if (right < west || left > east || top < south || bottom > north) return [];
  if (left >= west && right <= east && bottom >= south && top <= north) return points;
  let cut = points.slice(0, -1);
  cut = half(cut, 0, (at) => at >= west, west);
  cut = half(cut, 0, (at) => at <= east, east);
  cut = half(cut, 1, (at) => at >= south, south);
  cut = half(cut, 1, (at) => at <= north, north);
  return cut.length < 3 ? [] : [...cut, cut[0]];
}

// Sutherland and Hodgman: the part of a ring on one side of a straight line through `edge` of one coordinate.
function half(points, axis, holds, edge) {
  const cut = [];
  points.forEach((point, n) => {
    const before = points.at(n - 1);
    if (holds(point[axis]) !== holds(before[axis])) {
      const part = (edge - before[axis]) / (point[axis] - before[axis]);
      const other = before[1 - axis] + part * (point[1 - axis] - before[1 - axis]);
      cut.push(axis === 0 ? [edge, other] : [other, edge]);
    }
    if (holds(point[axis])) cut.push(point);
  });
  return cut;
}

const extents = new WeakMap();

// The same points are cut again and again.
function extent(points) {
  if (!extents.has(points)) {
    const [low, high] = [[Infinity, Infinity], [-Infinity, -Infinity]];
    for (const point of points) {
      for (const axis of [0, 1]) {
        low[axis] = Math.min(low[axis], point[axis]);
        high[axis] = Math.max(high[axis], point[axis]);
      }
    }
    extents.set(points, [low, high]);
  }
  return extents.get(points);
}

// A line: its pieces of which a part is in the box, with the whole segments at their ends.
export function line(points, box) {
  const pieces = [];
  if (!meets(...extent(points), box)) return pieces;
  let open = null;
  for (let n = 1; n < points.length; n++) {
    if (!meets(points[n - 1], points[n], box)) open = null;
    else if (open) open.push(points[n]);
    else pieces.push((open = [points[n - 1], points[n]]));
  }
  return pieces;
}

const meets = ([lon1, lat1], [lon2, lat2], { west, south, east, north }) =>
  Math.max(lon1, lon2) >= west && Math.min(lon1, lon2) <= east && Math.max(lat1, lat2) >= south && Math.min(lat1, lat2) <= north;
