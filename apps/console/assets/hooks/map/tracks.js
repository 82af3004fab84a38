// Where the vehicles have been since the page was opened. Bounded: with many vehicles each has a shorter track.
import { collection, distance, feature } from "./geo.js";

const POINTS = 24_000; // of all tracks
const LONGEST = 1_200;
const SHORTEST = 60;
const APART = 2; // metres
const JUMP = 5_000; // metres; a track does not cross a gap
const DRAW_MS = 1_000;

export class Tracks {
  constructor(map, colours) {
    this.map = map;
    this.colours = colours;
    this.tracks = new Map();
    this.shown = true;
    this.drawn = 0;
    map.addSource("tracks", { type: "geojson", data: collection(), tolerance: 0.5 });
    map.addLayer({
      id: "tracks", type: "line", source: "tracks",
      layout: { "line-join": "round", "line-cap": "round" },
      paint: { "line-color": colours().track, "line-width": 2, "line-opacity": 0.75 },
    });
  }

  put(vehicles) {
    const limit = Math.min(LONGEST, Math.max(SHORTEST, Math.floor(POINTS / Math.max(1, vehicles.size))));
    for (const id of this.tracks.keys()) if (!vehicles.has(id)) this.tracks.delete(id);
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
    const lines = [...this.tracks].filter(([, track]) => track.length > 1);
    this.map.getSource("tracks").setData(collection(lines.map(([id, track]) => feature("LineString", track, { id }))));
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
    this.map.setPaintProperty("tracks", "line-color", this.colours().track);
  }
}
