// Clusters, motion and colours of tags (assets/hooks/map/vehicles): needs no browser.
import assert from "node:assert/strict";
import { named } from "../../assets/hooks/map/vehicles/cluster_keys.js";
import { clustered } from "../../assets/hooks/map/vehicles/clusters.js";
import { distance } from "../../assets/hooks/map/geo.js";
import { again, opacity, shown } from "../../assets/hooks/map/vehicles/motion.js";
import { TAG_COLOURS, tagColours } from "../../assets/hooks/map/vehicles/tags.js";

const vehicle = (id, more = {}) => ({ id, position: [8.54, 47.39], state: "armed", speed: 0, course: null, at: 0, ...more });
const never = () => false;

// Clusters: the worst state counts, the selected and the urgent stay outside, and nobody is lost or there twice.
const fleet = [...Array(60)].map((_, n) => vehicle(`V${n}`, { position: [8.5 + (n % 6) * 0.0003, 47.3 + Math.floor(n / 6) * 0.0002], state: n === 7 ? "stale" : n % 2 ? "armed" : "disarmed" }));
const far = clustered(fleet, 9, ({ id }) => id === "V3");
assert.deepEqual(far.singles.map(({ id }) => id), ["V3"]);
assert.deepEqual(far.clusters.map(({ state, members }) => [state, members.length]), [["stale", 59]]);
assert.equal(clustered(fleet, 12, never).clusters.length, 0);
assert.deepEqual(clustered(fleet, 9, never), clustered([...fleet].reverse(), 9, never), "in any order");
for (const zoom of [0, 3.7, 8, 11]) {
  const spread = fleet.map((one, n) => ({ ...one, position: [n * 6 - 180, (n % 17) * 10 - 80] }));
  const { singles, clusters } = clustered(spread, zoom, never);
  assert.deepEqual([...singles, ...clusters.flatMap(({ members }) => members)].map(({ id }) => id).sort(), spread.map(({ id }) => id).sort());
}
assert.deepEqual(clustered([], 0, never), { singles: [], clusters: [] });
assert.equal(clustered([vehicle("A"), vehicle("B", { state: "disarmed" })], 1, never).clusters[0].state, "armed");
assert.equal(named(fleet), "60 vehicles, 1 stale: zoom in");
assert.equal(named([vehicle("A", { state: "lost" }), vehicle("B", { state: "failsafe" }), vehicle("C")]), "3 vehicles, 1 lost, 1 in failsafe: zoom in");

// Motion: on its way for one second and no further; what stands, is not heard, or is told exactly is where it was told to be.
const flies = vehicle("A", { speed: 10, course: 90 });
assert.deepEqual(shown(flies, 0), flies.position);
const moved = (ms) => distance(flies.position, shown(flies, ms));
assert.ok(Math.abs(moved(500) - 5) < 0.1 && Math.abs(moved(1_000) - 10) < 0.1);
assert.equal(moved(60_000), moved(1_000));
for (const still of [{ speed: 0.2 }, { course: null }, { state: "lost" }, { state: "stale" }, { at: Infinity }, { speed: null }])
  assert.deepEqual(shown({ ...flies, ...still }, 500), flies.position, JSON.stringify(still));

// Fading: with age, never away.
assert.equal(opacity(flies, 900), 1);
assert.ok(opacity(flies, 10_000) < 0.8 && opacity(flies, 1e9) > 0.4);
assert.ok(opacity(vehicle("A", { state: "lost" }), 10_000) < 0.8);
assert.equal(opacity(vehicle("A"), 1e9), 1, "what stands is not heard of because nothing changes");
assert.equal(opacity({ ...flies, at: Infinity }, 1e9), 1);

// Frames: only while something moves on the screen; a look each second while something fades; then nothing.
assert.equal(again([flies], 100, 0.5, 66), 66);
assert.equal(again([flies], 100, 50, 66), 1_000, "from far it does not move");
assert.equal(again([flies], 5_000, 0.5, 66), 1_000);
assert.equal(again([flies], 1e6, 0.5, 66), null);
assert.equal(again([vehicle("A"), { ...flies, at: Infinity }], 100, 0.5, 66), null);
assert.equal(again([], 0, 1, 66), null);

// Tags: no two have one colour while there are colours, in any order, and a new one leaves most of the others.
const tags = ["survey", "relay", "north", "south", "spare", "rescue", "b", "a"];
assert.equal(new Set(tagColours(tags).values()).size, TAG_COLOURS);
assert.deepEqual(tagColours([...tags].reverse()), tagColours(tags));
assert.equal(tagColours([...tags, "ninth", "tenth"]).size, 10);
assert.deepEqual(tagColours(["survey", "survey"]).size, 1);
