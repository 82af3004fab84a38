// What the map stands on: the layers that the gateway offers (`/tiles`), the one that this browser shows, what its licence asks to
// say, and the question to an admin while there is none. Nothing is loaded from elsewhere.
import { described } from "./archive.js";
import { button, element } from "../../../lib/dom.js";
import { npm } from "../npm.js";
import { swap } from "./style.js";

const KEPT = "map-layer"; // the id of the layer, or NONE
const NONE = "none";
const ASKED = "map-base-asked";
const MISSING = "Parts of the map are missing: the gateway cannot fetch them now.";

export async function offered() {
  try {
    const answer = await fetch("/tiles");
    if (!answer.ok) throw new Error(`${answer.status}`);
    return await answer.json();
  } catch (error) {
    console.warn("map: the layers cannot be read:", error?.message ?? error);
    return { layers: [], ask: false, may: false, fixed: true, failed: true };
  }
}

export class Base {
  // `hook`: that of the map; `offer`: what `offered` gives.
  constructor(hook, library, offer) {
    Object.assign(this, { hook, library, offer });
    this.attribution = hook.child("map-attribution");
  }

  // What style.js draws; null for nothing.
  async tiles() {
    this.drawn = this.shown();
    const layer = this.offer.layers.find(({ id }) => id === this.chosen());
    const tiles = layer ? await described(layer, this.library) : null;
    if (tiles?.type === "vector") tiles.basemaps = await import(npm("@protomaps/basemaps/index.js"));
    this.hook.say(tiles?.attribution ?? "", this.attribution);
    return tiles;
  }

  chosen() {
    const kept = localStorage.getItem(KEPT);
    return kept === NONE || this.offer.layers.some(({ id }) => id === kept) ? kept : (this.offer.layers[0]?.id ?? NONE);
  }

  // Tiles come, or do not, before the map is there.
  watch(map) {
    this.map = map;
    map.on("error", ({ sourceId }) => sourceId === "tiles" && this.miss(true));
    map.on("sourcedata", ({ sourceId, tile }) => sourceId === "tiles" && tile?.state === "loaded" && this.miss(false));
  }

  miss(missing) {
    this.missing = missing;
    if (missing) this.hook.say(MISSING);
    else if (this.hook.status.textContent === MISSING) this.hook.say("");
  }

  // The map is there.
  start() {
    if (this.missing) this.miss(true);
    this.show();
  }

  async choose(id) {
    localStorage.setItem(KEPT, id);
    await this.apply();
  }

  async apply() {
    this.hook.tiles = await this.tiles();
    if (!this.hook.gone) swap(this.map, this.hook.colours(), this.hook.tiles);
  }

  show() {
    this.panel?.remove();
    this.panel = null;
    this.hook.pressed("layers", false);
    if (this.offer.ask && (this.offer.may || !sessionStorage.getItem(ASKED))) this.ask();
  }

  ask() {
    const hide = () => { sessionStorage.setItem(ASKED, "1"); this.show(); };
    const use = button("Use OpenStreetMap", () => this.answer(true));
    use.title = "The gateway fetches it, and keeps what was looked at for a place without internet. Pages load nothing from elsewhere.";
    const parts = this.offer.may
      ? [use, this.file("Open a file…"), button("Stay without", () => this.answer(false))]
      : [element("p", { textContent: "An admin can choose one on this map." }), button("Hide", hide)];
    this.panelOf("map-question", "No base map", parts);
  }

  async answer(yes) {
    const kept = await fetch("/tiles", { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ openstreetmap: yes }) });
    if (!kept.ok) return this.panel.append(element("p", { role: "alert", textContent: await kept.text() }));
    await this.renew(null);
  }

  // A button that sends a PMTiles file to the gateway; while it is under way, the button stops it.
  file(text) {
    const label = element("label", { className: "button small", textContent: text });
    const input = element("input", { type: "file", accept: ".pmtiles", className: "visually-hidden" });
    input.addEventListener("change", () => input.files[0] && this.send(input.files[0]));
    label.append(input);
    return label;
  }

  send(file) {
    const name = file.name.replace(/\.pmtiles$/i, "").replace(/[^A-Za-z0-9_-]+/g, "-").slice(0, 40) || "map";
    const request = new XMLHttpRequest();
    const progress = element("p", { role: "status", textContent: `Sending ${file.name} …` });
    this.panelOf("map-upload", "Map file", [progress, button("Cancel", () => { request.abort(); this.show(); })]);
    request.upload.addEventListener("progress", ({ loaded, total }) => { progress.textContent = `Sending ${file.name}: ${Math.floor((100 * loaded) / total)} %`; });
    request.addEventListener("loadend", async () => {
      if (request.status === 200) return this.renew(`file-${name}`);
      progress.textContent = request.responseText || "It was not sent.";
      progress.setAttribute("role", "alert");
    });
    request.open("PUT", `/tiles/${name}`);
    request.setRequestHeader("content-type", "application/vnd.pmtiles");
    request.send(file);
  }

  // The tiles of what is in view, down to a zoom, before somebody goes where there is no internet; `asked`: one was begun just now.
  async area(layer, asked = false) {
    const { map } = this;
    const url = `/tiles/${layer.id}/area`;
    const words = element("p", { role: "status" });
    const zoom = element("input", { type: "number", min: layer.minzoom, max: layer.maxzoom, value: Math.min(layer.maxzoom, Math.max(16, Math.ceil(map.getZoom()))) });
    const ask = async (begin) => {
      const box = map.getBounds().toArray().flat();
      const answer = await fetch(url, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ box, zoom: zoom.valueAsNumber, begin }) });
      if (!answer.ok) words.textContent = `Not possible: ${await answer.text()}`;
      else if (begin) this.area(layer, true);
      else words.textContent = await answer.json().then(({ tiles, bytes }) => `What is in view: ${tiles} tiles, about ${Math.ceil(bytes / 1e6)} MB.`);
    };
    const state = await this.fetching(url);
    const busy = state && !state.ended;
    const far = ({ done, total, bytes }) => `${done} of ${total} tiles, ${Math.ceil(bytes / 1e6)} MB`;
    if (asked && state?.ended) words.textContent = state.ended === "done" ? `Fetched: ${far(state)}.` : `Ended after ${far(state)}: ${state.ended}.`;
    const back = button("Back", () => this.toggle());
    const label = element("label", { textContent: "Down to zoom" });
    label.append(zoom);
    this.panelOf("map-area", "Prepare an area", busy ? [words, button("Cancel", () => fetch(url, { method: "DELETE" })), back] : [label, words, button("Fetch", () => ask(true)), back]);
    const { panel } = this;
    panel.querySelector("input, button").focus();
    const here = () => this.panel === panel && !this.hook.gone;
    const follow = async () => {
      const now = await this.fetching(url);
      if (!here() || !now) return;
      if (now.ended) return this.area(layer, true);
      words.textContent = `Fetching: ${far(now)}.`;
      setTimeout(follow, 1000);
    };
    if (busy) return follow();
    const changed = () => (here() ? ask(false) : map.off("moveend", changed));
    zoom.addEventListener("change", changed);
    map.on("moveend", changed);
    if (!words.textContent) changed();
  }

  async fetching(url) {
    return fetch(url).then((answer) => (answer.ok ? answer.json() : null));
  }

  async remove(id, name) {
    if (!window.confirm(`Remove the map file ${name} from the gateway, for all?`)) return;
    const gone = await fetch(`/tiles/${id}`, { method: "DELETE" });
    if (!gone.ok) return this.panel.append(element("p", { role: "alert", textContent: await gone.text() }));
    await this.renew(null);
  }

  // This page has changed what is offered; `id` is the layer to show.
  async renew(id) {
    if (id) localStorage.setItem(KEPT, id);
    else localStorage.removeItem(KEPT);
    this.panel?.remove();
    this.panel = null;
    await this.changed();
  }

  // The gateway has told that other layers are offered, or this page knows it. A file that is being sent goes on.
  async changed() {
    const offer = await offered();
    if (this.hook.gone || offer.failed) return;
    this.offer = offer;
    const open = this.panel?.dataset.name;
    if (open === "map-layers") this.toggle(true);
    else if (!["map-upload", "map-area"].includes(open)) this.show();
    if (this.shown() !== this.drawn) await this.apply();
  }

  // What decides how the tiles look: the layer with all that the gateway says of it.
  shown() {
    return JSON.stringify(this.offer.layers.find(({ id }) => id === this.chosen()) ?? null);
  }

  get decides() {
    return this.offer.may && !this.offer.fixed;
  }

  // The layers to choose from, and for an admin the answer about OpenStreetMap.
  toggle(again = false) {
    if (!again && this.panel?.dataset.name === "map-layers") return this.show();
    const focused = !again || this.panel.contains(document.activeElement);
    const offers = [...this.offer.layers, { id: NONE, name: "None" }];
    const chosen = this.chosen();
    const radios = offers.map(({ id, name }) => {
      const input = element("input", { type: "radio", name: `${this.hook.el.id}-layer`, value: id, checked: id === chosen });
      input.addEventListener("change", () => this.choose(id));
      const label = element("label");
      label.append(input, name);
      return label;
    });
    const use = !this.offer.openstreetmap;
    const change = button(use ? "Use OpenStreetMap for all" : "Stop using OpenStreetMap", () => this.answer(use));
    const removals = this.offer.layers.filter(({ uploaded }) => uploaded).map(({ id, name }) => button(`Remove ${name}`, () => this.remove(id, name)));
    const layer = this.offer.layers.find(({ id }) => id === chosen);
    const prepare = this.offer.may && layer?.prepares ? [button("Prepare an area…", () => this.area(layer))] : [];
    this.panelOf("map-layers", "Base map", [...radios, ...prepare, ...(this.decides ? [change] : []), ...(this.offer.may ? [this.file("Add a map file…"), ...removals] : [])]);
    this.hook.pressed("layers", true);
    if (focused) this.panel.querySelector("input:checked").focus();
    this.panel.addEventListener("keydown", (event) => {
      if (event.key !== "Escape") return;
      this.show();
      this.hook.el.querySelector("[data-tool=layers]").focus();
    });
  }

  panelOf(name, title, parts) {
    this.panel?.remove();
    this.panel = element("section", { className: "map-panel", "data-name": name, "aria-label": title });
    this.panel.append(element("h3", { textContent: title }), ...parts);
    this.hook.el.append(this.panel);
  }
}
