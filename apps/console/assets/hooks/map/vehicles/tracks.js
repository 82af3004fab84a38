// Where the vehicles have been since the page was opened. Bounded: with many vehicles each has a shorter track.
import { collection, distance, feature } from "../geo.js";
import { TAG_COLOURS } from "./tags.js";

const POINTS = 24_000; // of all tracks
const LONGEST = 1_200;
const SHORTEST = 60;
const APART = 2; // metres
const JUMP = 5_000; // metres; a track does not cross a gap
const DRAW_MS = 1_000;
const FADED = [0.25, 0.5, 0.8]; // the thirds of a track, the oldest first

export class Tracks {
  constructor(map, colours) {
    this.map = map;
    this.colours = colours;
    this.tracks = new Map();
    this.tags = new Map(); // numbers of colours
    this.shown = true;
    this.drawn = 0;
    map.addSource("tracks", { type: "geojson", data: collection(), tolerance: 0.5 });
    map.addLayer({
      id: "tracks", type: "line", source: "tracks",
      layout: { "line-join": "round", "line-cap": "round" },
      paint: { "line-color": paint(colours()), "line-width": 2, "line-opacity": ["get", "opacity"] },
    });
  }

  put(vehicles) {
    const limit = Math.min(LONGEST, Math.max(SHORTEST, Math.floor(POINTS / Math.max(1, vehicles.size))));
    for (const id of this.tracks.keys()) if (!vehicles.has(id)) this.tracks.delete(id);
    this.vehicles = vehicles;
    for (const { id, position } of vehicles.values()) this.add(id, position, limit);
    this.draw();
  }

  add(id, position, limit) {
    const track = this.tracks.get(id) ?? [];
    const last = track.at(-1);
    const gone = last ? distance(last, position) : Infinity;
    if (gone < APART) return;
    if (last && gone > JUMP) track.length = 0;
    track.push(position);
    if (track.length > limit) track.splice(0, track.length - limit);
    this.tracks.set(id, track);
  }

  // The whole source is built anew, so not for each push.
  draw(now = performance.now()) {
    if (!this.shown || now - this.drawn < DRAW_MS) return;
    this.drawn = now;
    const lines = [...this.tracks].filter(([, track]) => track.length > 1).flatMap(([id, track]) => {
      const third = Math.ceil((track.length - 1) / FADED.length);
      const colour = this.tags.get(this.vehicles.get(id)?.tag) ?? -1;
      const parts = FADED.map((opacity, n) => [track.slice(n * third, (n + 1) * third + 1), opacity]);
      return parts.filter(([part]) => part.length > 1).map(([part, opacity]) => feature("LineString", part, { id, colour, opacity }));
    });
    this.map.getSource("tracks").setData(collection(lines));
  }

  show(shown) {
    this.shown = shown;
    this.map.setLayoutProperty("tracks", "visibility", shown ? "visible" : "none");
    this.drawn = 0;
    this.draw();
  }

  clear() {
    this.tracks.clear();
    this.drawn = 0;
    this.draw();
  }

  repaint() {
    this.map.setPaintProperty("tracks", "line-color", paint(this.colours()));
  }
}

const paint = (c) => ["match", ["get", "colour"], ...Array.from({ length: TAG_COLOURS }, (_, n) => [n, c[`tag-${n}`]]).flat(), c.track];
