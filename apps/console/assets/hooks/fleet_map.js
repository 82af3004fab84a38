// The hook of `Aerie.Console.Map.map/1`; the README in lib/aerie/console/map describes attributes and events.
import { element } from "../lib/dom.js";
import { hint } from "../lib/hint.js";
import { Base, offered } from "./map/base/base.js";
import { Coastlines } from "./map/base/coastlines.js";
import { graticule } from "./map/base/graticule.js";
import { colours, style } from "./map/base/style.js";
import { bounds } from "./map/geo.js";
import { repaint } from "./map/layers.js";
import { npm } from "./map/npm.js";
import { Overlays } from "./map/overlays.js";
import { box } from "./map/tools/box.js";
import { Measure } from "./map/tools/measure.js";
import { PlaceMenu, whenResting } from "./map/tools/menu.js";
import { PlanEditor } from "./map/tools/plan.js";
import { toolbar } from "./map/tools/toolbar.js";
import { paint } from "./map/vehicles/tags.js";
import { Tracks } from "./map/vehicles/tracks.js";
import { update, Vehicles } from "./map/vehicles/vehicles.js";

const NO_WEBGL = "The map needs WebGL 2, which this browser or machine does not offer.";
const NO_MAP = "The map could not be loaded.";
const still = window.matchMedia("(prefers-reduced-motion: reduce)");
const CLOSEST = 16; // zoom of a view that fits everything

export default {
  async mounted() {
    this.fleet = new Map();
    this.last = {};
    for (const name of ["vehicles", "homes", "plans", "zones", "preview", "target", "plan", "fit", "centre"]) {
      this.handleEvent(`map:${name}`, (payload) => {
        if (payload.map !== this.el.id) return;
        if (name === "vehicles") update(this.fleet, payload);
        // While the map is loading, the latest of each is kept.
        if (this.map) this[name](payload);
        else this.last[name] = payload;
      });
    }
    this.handleEvent("map:layers", () => this.base?.changed());
    this.build();
    if (!document.createElement("canvas").getContext("webgl2")) return this.fail(NO_WEBGL);
    try {
      const [library, offer] = await Promise.all([import(npm("maplibre-gl/maplibre-gl.mjs")), offered()]);
      this.base = new Base(this, library, offer);
      const tiles = await this.base.tiles();
      if (!this.gone) this.open(library, tiles);
    } catch (error) {
      console.error(error);
      this.fail(NO_MAP);
    }
  },

  // The element's attributes have changed; what is in it is ours (phx-update="ignore").
  updated() {
    if (!this.map) return;
    const { follow, tool } = this.el.dataset;
    this.vehiclesLayer.select(this.fleet, this.list("selected"));
    // Only what the page asks anew: what the operator did since then is on its way to it.
    if (follow !== this.asked?.follow) this.setFollow(follow || null);
    if (tool !== this.asked?.tool) this.setTool(tool);
    this.asked = { follow, tool };
    this.ring();
  },

  destroyed() {
    this.gone = true;
    window.removeEventListener("theme", this.theme);
    for (const event of ["pointerup", "pointercancel", "blur"]) window.removeEventListener(event, this.released);
    delete this.el.fleetMap;
    this.map?.remove();
  },

  list(name) {
    return JSON.parse(this.el.dataset[name] || "[]");
  },

  build() {
    this.canvas = this.child("map-canvas");
    this.notice = this.child("map-notice");
    this.notice.setAttribute("role", "status");
    this.status = this.child("map-status");
    this.status.setAttribute("aria-live", "polite");
    this.say("Loading the map …", this.notice);
  },

  child(name, kind = "div") {
    const made = element(kind, { className: name });
    this.el.append(made);
    return made;
  },

  say(text, element = this.status) {
    element.textContent = text;
    element.hidden = text === "";
  },

  fail(text) {
    this.el.classList.add("map-failed");
    this.say(this.el.id === "fleet-map" ? `${text} The table shows every vehicle.` : text, this.notice);
  },

  open({ Map, ScaleControl }, tiles) {
    this.colours = colours;
    const map = new Map({
      container: this.canvas,
      style: style(this.colours(), tiles),
      ...this.remembered(),
      attributionControl: false,
      fadeDuration: 0,
      maxPitch: 0,
      dragRotate: true,
      renderWorldCopies: true,
      locale: { "Map.Title": this.el.dataset.label ?? "Map" },
    });
    map.touchZoomRotate.disableRotation();
    map.addControl(new ScaleControl({ maxWidth: 120 }), "bottom-left");
    map.on("error", ({ error }) => console.warn("map:", error?.message ?? error));
    this.base.watch(map);
    map.on("webglcontextlost", () => this.say("The map's graphics were lost; waiting for the browser to restore them.", this.notice));
    map.on("webglcontextrestored", () => this.say("", this.notice));
    map.once("load", () => this.loaded(map, tiles));
  },

  loaded(map, tiles) {
    this.map = map;
    this.tiles = tiles;
    new Coastlines(map);
    const grid = () => {
      const view = map.getBounds();
      const box = { west: view.getWest(), south: view.getSouth(), east: view.getEast(), north: view.getNorth() };
      map.getSource("graticule").setData(graticule(box, map.getZoom()));
    };
    map.on("moveend", () => {
      grid();
      this.remember();
    });
    grid();

    this.overlays = new Overlays(map, this.colours);
    this.tracks = new Tracks(map, this.colours);
    this.measure = new Measure(map, this.colours, (text) => this.say(text));
    this.editor = new PlanEditor(map, this.colours, (event, payload) => this.push(event, payload));
    this.vehiclesLayer = new Vehicles(map, this.colours, (tags) => this.legend(tags));

    this.buttons();
    this.listen();
    this.watchTheme();
    this.say("", this.notice);
    this.say("");
    this.updated();
    this.base.start();
    for (const [name, payload] of Object.entries(this.last)) this[name](payload);
    this.last = {};
    // For tests, and for a look from the browser's console.
    this.el.fleetMap = this;
    this.el.classList.add("map-ready");
  },

  push(event, payload) {
    if (this.liveSocket.isConnected()) this.pushEvent(event, { map: this.el.id, ...payload });
    else hint("The gateway does not answer: nothing was done on the map.");
  },

  buttons() {
    const wanted = this.list("tools");
    const all = [
      { name: "in", label: "Zoom in", press: () => this.map.zoomIn() },
      { name: "out", label: "Zoom out", press: () => this.map.zoomOut() },
      { name: "north", label: "North up", press: () => this.map.resetNorth() },
      { name: "fit", label: "Show all vehicles", press: () => this.fit({}) },
      { name: "follow", label: "Follow the selected vehicle", toggle: true, press: () => this.toggleFollow() },
      { name: "tracks", label: "Tracks", toggle: true, press: () => this.showTracks(!this.tracks.shown) },
      { name: "rings", label: "Range rings around the selected vehicles", toggle: true, press: () => this.showRings(!this.ringsOn) },
      { name: "measure", label: "Measure distances", toggle: true, press: () => this.setTool(this.tool === "measure" ? this.el.dataset.tool : "measure") },
    ];
    const layers = { name: "layers", label: "Base map", toggle: true, press: () => this.base.toggle() };
    const { bar, press } = toolbar([...all.filter(({ name }) => wanted.includes(name)), layers]);
    this.pressed = press;
    this.el.append(bar);
    this.showTracks(true);
  },

  listen() {
    const { map } = this;
    map.on("click", (event) => this.clicked(event));
    this.menu = new PlaceMenu(this.el, (act) => this.chosen(act), () => this.aim());
    map.on("contextmenu", ({ point, lngLat }) => this.ask(point, lngLat));
    whenResting(map, ({ point, lngLat }) => this.ask(point, lngLat));
    map.on("movestart", ({ originalEvent }) => originalEvent && this.menu.close());
    if ("box" in this.el.dataset) box(map, this.canvas, (within, less) => this.boxed(within, less));
    // While a finger is on the map, it is not moved from below it.
    for (const event of ["mousedown", "touchstart"]) map.on(event, () => { this.held = true; });
    this.released = () => { this.held = false; };
    for (const event of ["pointerup", "pointercancel", "blur"]) window.addEventListener(event, this.released);
    map.on("dragstart", () => this.following && this.letGo());
    map.on("mousemove", ({ point }) => {
      if (this.tool === "select") map.getCanvas().style.cursor = this.vehiclesLayer.at(point) ? "pointer" : "";
    });
    this.canvas.addEventListener("keydown", (event) => this.key(event));
  },

  // The menu of a place, on pages that have one.
  ask(point, lngLat) {
    if (!this.el.dataset.menu || this.tool === "measure" || this.menu.isOpen) return;
    const { vehicle, path, items, note } = JSON.parse(this.el.dataset.menu);
    const here = place(lngLat);
    this.asking = { vehicle, path, ...here };
    const measure = { act: "measure", label: "Measure from here" };
    this.menu.open({ title: vehicle ?? "This place", items: [...items, measure], note }, here, point);
    this.overlays.target({ ...here, text: "here" });
  },

  chosen(act) {
    const { vehicle, path, lat, lon } = this.asking;
    if (act === "measure") {
      this.setTool("measure");
      this.measure.add([lon, lat]);
    } else if (path) this.js().navigate(`${path}?${new URLSearchParams({ act, lat, lon })}`);
    else this.push("map_guided", { act, vehicle, lat, lon });
  },

  boxed(within, less) {
    const ids = [...this.fleet].filter(([, { position }]) => within(this.map.project(position))).map(([id]) => id);
    if (ids.length) this.push("map_box", { ids, less });
    this.say(`${ids.length === 1 ? "1 vehicle" : `${ids.length} vehicles`} in the box${ids.length ? (less ? ", removed from the selection" : ", added to the selection") : ""}.`);
  },

  clicked({ point, lngLat, originalEvent }) {
    // The end of the touch that has opened it.
    if (this.menu.isOpen) return;
    if (this.tool === "measure") return this.measure.add([lngLat.lng, lngLat.lat]);
    if (this.tool === "plan" && this.editor.clicked(point, lngLat)) return;
    if (this.tool === "point") return this.push("map_point", place(lngLat));
    const id = this.vehiclesLayer.at(point);
    if (!id && this.vehiclesLayer.open(point)) return;
    if (id) this.push("map_select", { id, add: originalEvent.shiftKey || originalEvent.ctrlKey || originalEvent.metaKey });
  },

  // Which tag has which colour, here and on the page's chips.
  legend(tags) {
    this.tagList ??= this.child("map-legend", "ul");
    this.tagList.setAttribute("aria-label", "Colours of tags");
    this.tagList.replaceChildren(...[...tags.keys()].slice(0, 10).map((tag) => element("li", { textContent: tag, "data-tag": tag })));
    paint(tags);
    this.tracks.tags = tags;
  },

  // With the keyboard, a place is the centre of the view, which a cross marks.
  key(event) {
    const centre = this.map.getCenter();
    if (event.key === "ContextMenu" || (event.key === "F10" && event.shiftKey)) this.ask(this.map.project(centre), centre);
    else if (event.key === "Escape" && this.tool === "measure") this.setTool(this.el.dataset.tool);
    else if (event.key === "Escape") this.push("map_escape", {});
    else if (event.key === "Backspace" && this.tool === "measure") this.measure.removeLast();
    else if (event.key === "Enter" && this.tool === "measure") this.measure.add([centre.lng, centre.lat]);
    else if (event.key === "Enter" && this.tool === "point") this.push("map_point", place(centre));
    else if (event.key === "Enter" && this.tool === "plan") this.editor.add(centre);
    else return;
    event.preventDefault();
  },

  setTool(tool) {
    this.tool = tool || "select";
    this.el.classList.toggle("map-aiming", this.tool !== "select");
    this.map.getCanvas().style.cursor = this.tool === "select" ? "" : "crosshair";
    this.pressed?.("measure", this.tool === "measure");
    this.editor.enable(this.tool === "plan");
    if (this.tool === "measure") this.measure.draw();
    else {
      this.measure.clear();
      this.say(this.tool === "point" ? "Click a place on the map, or press Enter to take its centre. Escape cancels." : "");
    }
  },

  // What the server pushes.

  vehicles() {
    this.vehiclesLayer.draw(this.fleet);
    this.tracks.put(this.fleet);
    if (!this.fitted && this.fleet.size > 0) {
      this.fitted = true;
      if (!this.hadView && !this.following) this.fit({ animate: false });
    }
    if (this.following && !this.held && !this.menu.isOpen) this.chase();
    if (this.aimed?.from && !this.menu.isOpen) this.aim();
    this.ring();
  },

  homes({ homes }) {
    this.overlays.homes(homes);
  },

  plans({ plans }) {
    this.overlays.plans(plans);
  },

  zones({ zones }) {
    this.overlays.zones(zones);
  },

  preview({ routes }) {
    this.overlays.preview(routes);
  },

  target({ place: target }) {
    this.aimed = target;
    if (!this.menu.isOpen) this.aim();
  },

  // The place that a vehicle may go to, with the way there from where it is now.
  aim() {
    this.overlays.target(this.aimed, this.fleet.get(this.aimed?.from)?.position);
  },

  plan({ plan }) {
    this.editor.show(plan);
  },

  centre({ lat, lon, zoom }) {
    this.map.easeTo({ center: [lon, lat], ...(zoom ? { zoom } : {}) });
  },

  fit({ ids, animate = true }) {
    const aimed = ids?.includes(this.aimed?.from) ? [[this.aimed.lon, this.aimed.lat]] : [];
    const view = bounds([...this.positions(ids), ...aimed, ...(ids?.length ? [] : this.editor.positions())]);
    if (view) this.map.fitBounds(view, { padding: 60, maxZoom: CLOSEST, animate });
  },

  positions(ids = [...this.fleet.keys()]) {
    return ids.flatMap((id) => (this.fleet.has(id) ? [this.fleet.get(id).position] : []));
  },

  // Following

  toggleFollow() {
    const [first] = this.list("selected");
    const id = this.following ? null : (this.el.dataset.follow || first);
    if (!this.following && !id) return this.say("Select a vehicle to follow it.");
    this.setFollow(id);
    this.push("map_follow", { id });
  },

  setFollow(id) {
    if (id === (this.following ?? null)) return;
    this.following = id;
    this.pressed?.("follow", id !== null);
    this.far = true;
    if (!this.held) this.chase();
  },

  // The operator has moved the map.
  letGo() {
    this.setFollow(null);
    this.push("map_follow", { id: null });
  },

  chase() {
    const [position] = this.following ? this.positions([this.following]) : [];
    if (!position) return;
    // The first step is a jump: each next one would interrupt an animation, and leave the zoom where it was then.
    if (this.far || still.matches) this.map.jumpTo({ center: position, ...(this.far && this.map.getZoom() < 13 ? { zoom: CLOSEST } : {}) });
    else this.map.easeTo({ center: position, duration: 200, easing: (t) => t, essential: true });
    this.far = false;
  },

  showTracks(shown) {
    this.tracks.show(shown);
    this.pressed("tracks", shown);
  },

  showRings(shown) {
    this.ringsOn = shown;
    this.pressed("rings", shown);
    this.ring();
    if (shown && !this.ringedIds().length) this.say("Select vehicles to see their range rings.");
  },

  ring() {
    this.overlays.rings(this.ringsOn ? this.positions(this.ringedIds()) : null);
  },

  ringedIds() {
    return this.following ? [this.following] : this.list("selected");
  },

  // The view is kept for the next look at this page in this tab.

  remembered() {
    const kept = JSON.parse(sessionStorage.getItem(`map:${this.el.id}`) ?? "null");
    this.hadView = kept !== null;
    return kept ?? { center: [0, 20], zoom: 1 };
  },

  remember() {
    const { lng, lat } = this.map.getCenter();
    const view = { center: [lng, lat], zoom: this.map.getZoom(), bearing: this.map.getBearing() };
    sessionStorage.setItem(`map:${this.el.id}`, JSON.stringify(view));
  },

  watchTheme() {
    this.theme = () => {
      repaint(this.map, style(this.colours(), this.tiles).layers);
      for (const part of [this.vehiclesLayer, this.tracks, this.overlays, this.measure, this.editor]) part.repaint();
    };
    window.addEventListener("theme", this.theme);
  },
};

const place = ({ lng, lat }) => ({ lat, lon: ((((lng + 180) % 360) + 360) % 360) - 180 });
