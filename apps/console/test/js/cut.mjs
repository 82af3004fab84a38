// What is cut of rings and lines (assets/hooks/map/base/cut.js): needs no browser.
import assert from "node:assert/strict";
import { line, ring } from "../../assets/hooks/map/base/cut.js";

const box = { west: 0, south: 0, east: 10, north: 10 };
const square = (west, south, size) => [[west, south], [west + size, south], [west + size, south + size], [west, south + size], [west, south]];
const area = (points) => Math.abs(points.slice(1).reduce((sum, [x, y], n) => sum + points[n][0] * y - x * points[n][1], 0)) / 2;

assert.deepEqual(ring(square(2, 2, 3), box), square(2, 2, 3));
assert.deepEqual(ring(square(20, 2, 3), box), []);
assert.equal(area(ring(square(-5, -5, 10), box)), 25);
assert.equal(area(ring(square(-50, -50, 200), box)), 100, "the box is in the middle of the land");
// A comb whose teeth are in the box, and whose back is not: its area is right though it is one ring.
assert.equal(area(ring([[-5, 1], [5, 1], [5, 3], [-1, 3], [-1, 5], [5, 5], [5, 7], [-5, 7], [-5, 1]], box)), 20);

assert.deepEqual(line([[2, 2], [3, 3]], box), [[[2, 2], [3, 3]]]);
assert.deepEqual(line([[20, 2], [30, 3]], box), []);
// It leaves the box and comes back; and one that only crosses it.
assert.deepEqual(line([[2, 2], [20, 2], [30, 2], [20, 4], [3, 4]], box), [[[2, 2], [20, 2]], [[20, 4], [3, 4]]]);
assert.deepEqual(line([[-5, 5], [15, 5]], box), [[[-5, 5], [15, 5]]]);

// Any ring: what is cut is in the box, closed, and no larger than the box.
for (let n = 0; n < 2000; n++) {
  const points = Array.from({ length: 3 + (n % 9) }, () => [Math.random() * 40 - 15, Math.random() * 40 - 15]);
  const cut = ring([...points, points[0]], box);
  if (cut.length === 0) continue;
  assert.deepEqual(cut[0], cut.at(-1));
  for (const [x, y] of cut) assert(x >= 0 && x <= 10 && y >= 0 && y <= 10, `${x} ${y}`);
}
