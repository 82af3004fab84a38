// The fleet's map and table in a browser. Arguments: the console's address, a user's name and password, what to do: `flows`, or
// `fleet` with a number of vehicles that move.
import { chromium } from "playwright-core";
import { PATIENCE_MS } from "../../../../test/browser/chromium.mjs";

const [url, name, password, task, count, shots] = process.argv.slice(2);
// Pages are our own; a container often has no user namespaces for the sandbox. There is no GPU in most.
const browser = await chromium.launch({
  executablePath: process.env.AERIE_CHROMIUM,
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", ...(task === "nowebgl" ? ["--disable-gpu", "--disable-webgl", "--disable-webgl2", "--disable-3d-apis"] : [])],
});
const complaints = [];
const trouble = []; // of the pages' connections

async function open(path = "/", options = {}) {
  const context = await browser.newContext({ viewport: { width: 1280, height: 720 }, ...options });
  const page = await context.newPage();
  page.setDefaultTimeout(PATIENCE_MS);
  page.on("console", (message) => { if (["error", "warning"].includes(message.type())) complaints.push(message.text()); });
  page.on("pageerror", (error) => complaints.push(error.stack));
  page.on("websocket", (socket) => {
    socket.on("close", () => trouble.push("closed"));
    socket.on("framereceived", ({ payload }) => /"phx_(error|close)"|"(redirect|live_redirect|reload)"/.test(payload) && trouble.push(String(payload).slice(0, 200)));
  });
  await page.goto(url + "/sign-in");
  await page.fill("input[name=name]", name);
  await page.fill("input[name=password]", password);
  await page.click("button[type=submit]");
  await page.goto(url + path);
  await page.waitForSelector("[data-phx-main].phx-connected");
  return page;
}

const ready = (page) => page.waitForSelector("#fleet-map.map-ready");
// The vehicles that the map has drawn: id to [x, y] on the screen and the name of the symbol.
const drawn = (page) => page.evaluate(() => {
  const { map } = document.querySelector("#fleet-map").fleetMap;
  const found = map.queryRenderedFeatures({ layers: ["vehicles"] });
  return Object.fromEntries(found.map(({ properties, geometry }) => {
    const { x, y } = map.project(geometry.coordinates);
    return [properties.id, { x, y, symbol: properties.symbol, selected: properties.selected }];
  }));
});
const until = async (what, holds) => {
  const end = Date.now() + PATIENCE_MS;
  for (;;) {
    const value = await holds();
    if (value) return value;
    if (Date.now() > end) throw new Error(`not so in time: ${what}`);
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
};
const equal = (what, found, expected) => {
  if (JSON.stringify(found) !== JSON.stringify(expected)) throw new Error(`${what}: expected ${JSON.stringify(expected)}, found ${JSON.stringify(found)}`);
};
const selected = (page) => page.$$eval("#fleet-table tr[aria-selected=true]", (rows) => rows.map((row) => row.dataset.id));

const tasks = {
  // VID-1 moves, VID-2 is lost, VID-3 is disarmed.
  async flows() {
    const page = await open();
    await ready(page);
    const first = await until("three vehicles are drawn", async () => { const all = await drawn(page); return Object.keys(all).length === 3 && all; });
    equal("symbols", Object.keys(first).sort().map((id) => first[id].symbol), ["vehicle-copter-armed", "vehicle-plane-lost", "vehicle-rover-disarmed"]);

    // It moves on the map, and leaves a track.
    await until("VID-1 moves", async () => { const now = (await drawn(page))["VID-1"]; return now && Math.hypot(now.x - first["VID-1"].x, now.y - first["VID-1"].y) > 3; });
    await until("VID-1 has a track", () => page.evaluate(() => document.querySelector("#fleet-map").fleetMap.map.querySourceFeatures("tracks").length > 0));
    await until("land is drawn", () => page.evaluate(() => document.querySelector("#fleet-map").fleetMap.map.queryRenderedFeatures({ layers: ["land"] }).length > 0));

    // A click on the map selects there and in the table; with Ctrl one more.
    const box = await page.locator("#fleet-map").boundingBox();
    const click = async (id, options) => { const { x, y } = (await drawn(page))[id]; await page.mouse.click(box.x + x, box.y + y); };
    await click("VID-2");
    await until("VID-2 is selected", async () => (await selected(page)).join() === "VID-2");
    await page.keyboard.down("Control");
    await click("VID-3");
    await page.keyboard.up("Control");
    await until("both are selected", async () => (await selected(page)).join() === "VID-2,VID-3");
    await until("the map shows the selection", async () => { const all = await drawn(page); return all["VID-2"].selected && all["VID-3"].selected && !all["VID-1"].selected; });

    // In the table: a click, Shift for a range, the keyboard.
    await page.click("#vehicle-VID-1 td[data-label=Mode]");
    await until("VID-1 alone", async () => (await selected(page)).join() === "VID-1");
    await page.keyboard.press("Shift+ArrowDown");
    await until("a range", async () => (await selected(page)).join() === "VID-1,VID-2");
    await page.keyboard.press("Control+a");
    await until("all", async () => (await selected(page)).length === 3);
    await page.keyboard.press("Escape");
    await until("none", async () => (await selected(page)).length === 0);
    await page.click("#vehicle-VID-1 input");
    await page.click("#vehicle-VID-3 input");
    await until("two by their boxes", async () => (await selected(page)).join() === "VID-1,VID-3");

    // Following, until the map is moved.
    await page.keyboard.press("Escape");
    await page.click("#vehicle-VID-1 td[data-label=Mode]");
    await until("VID-1 alone again", async () => (await selected(page)).join() === "VID-1");
    await page.click("[data-tool=follow]");
    const off = () => page.evaluate(() => {
      const { map, fleet } = document.querySelector("#fleet-map").fleetMap;
      const at = map.project(fleet.get("VID-1").position);
      return Math.hypot(at.x - map.getCanvas().clientWidth / 2, at.y - map.getCanvas().clientHeight / 2);
    });
    await until("VID-1 is in the middle", async () => (await off()) < 30);
    // A frame of software WebGL may take long, so the hand goes on until it has moved the map.
    await page.mouse.move(box.x + 200, box.y + 300);
    await page.mouse.down();
    let at = 300;
    await until("following has ended", async () => {
      await page.mouse.move(box.x + 200, box.y + (at += 5));
      return (await page.getAttribute("[data-tool=follow]", "aria-pressed")) === "false";
    });
    await page.mouse.up();

    // Rings and the ruler.
    await page.click("[data-tool=rings]");
    await until("rings", () => page.evaluate(() => document.querySelector("#fleet-map").fleetMap.overlays.parts.rings.length === 6));
    await page.click("[data-tool=measure]");
    for (const part of [0.3, 0.6]) await page.mouse.click(box.x + part * box.width, box.y + 400);
    await until("a distance", async () => /^Distance: [\d.]+ k?m$/.test(await page.textContent(".map-status")));
    await page.focus("#fleet-map canvas");
    await page.keyboard.press("Escape");
    await until("the ruler is put away", async () => (await page.getAttribute("[data-tool=measure]", "aria-pressed")) === "false");

    // The connection breaks: the map and the selection are there again.
    await page.evaluate(() => { window.same = true; });
    await page.click("[data-tool=fit]");
    await page.evaluate(() => document.querySelector("#fleet-map").fleetMap.liveSocket.getSocket().conn.close());
    await page.waitForSelector("[data-phx-main].phx-connected");
    await until("VID-1 is still selected", async () => (await selected(page)).join() === "VID-1");
    await until("three vehicles are drawn again", async () => Object.keys(await drawn(page)).length === 3);
    equal("the page was not loaded again", await page.evaluate(() => window.same), true);

    // Dark and light.
    const water = () => page.evaluate(() => document.querySelector("#fleet-map").fleetMap.map.getPaintProperty("water", "background-color"));
    const before = await water();
    await page.evaluate(() => { document.documentElement.dataset.theme = "dark"; window.dispatchEvent(new CustomEvent("theme")); });
    await until("the map is dark", async () => (await water()) !== before);
    if (shots) await page.screenshot({ path: `${shots}/fleet-dark.png` });
    await page.evaluate(() => { document.documentElement.dataset.theme = "light"; window.dispatchEvent(new CustomEvent("theme")); });
    if (shots) await page.screenshot({ path: `${shots}/fleet-light.png` });

    // On a phone, the map above the rows, or alone, and nothing is wider than it.
    const phone = await open("/", { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true });
    await ready(phone);
    await phone.waitForSelector("#fleet-table", { state: "visible" });
    if (shots) await phone.screenshot({ path: `${shots}/fleet-phone-map.png` });
    const tools = () => phone.locator(".map-tools > button:visible").count();
    equal("one button", await tools(), 1);
    await phone.tap("[data-tool=more]");
    equal("all of them", await tools(), 10);
    await phone.tap("[data-tool=more]");
    equal("one again", [await tools(), await phone.getAttribute("[data-tool=more]", "aria-expanded")], [1, "false"]);
    equal("no scrolling sideways", await phone.evaluate(() => document.documentElement.scrollWidth), 390);
    await phone.tap("#fleet-split button");
    await phone.waitForSelector("#fleet-table", { state: "hidden" });
    equal("the map is there", await phone.isVisible("#fleet-map canvas"), true);
  },

  // VID-1 and VID-3 stand, VID-1 with the tag `survey`; VID-2 is lost.
  async symbols() {
    const page = await open();
    await ready(page);
    const first = await until("three vehicles are drawn", async () => { const all = await drawn(page); return Object.keys(all).length === 3 && all; });
    const number = /^vehicle-copter-armed-(\d)$/.exec(first["VID-1"].symbol)?.[1];
    equal("the others have the colours of their state", [first["VID-2"].symbol, first["VID-3"].symbol], ["vehicle-plane-lost", "vehicle-rover-disarmed"]);
    equal("the legend", await page.textContent(".map-legend"), "survey");
    const colours = () => page.evaluate((number) => {
      const of = (element, property, pseudo) => getComputedStyle(document.querySelector(element), pseudo)[property];
      const probe = Object.assign(document.body.appendChild(document.createElement("i")), { style: `color: var(--map-tag-${number})` });
      const wanted = getComputedStyle(probe).color;
      probe.remove();
      return [of(".map-legend li", "color", "::before"), of(".fleet-groups [data-tag=survey] .icon", "fill")].map((found) => found === wanted);
    }, number);
    equal("its colour, and that of its chip", await colours(), [true, true]);
    if (shots) await page.screenshot({ path: `${shots}/map-tags.png` });
    const shown = () => page.evaluate(() => {
      const { map } = document.querySelector("#fleet-map").fleetMap;
      const of = (layer) => map.queryRenderedFeatures({ layers: [layer] }).map(({ properties }) => properties);
      return { ids: of("vehicles").map(({ id }) => id).sort().join(), clusters: of("vehicles-cluster").map(({ count, symbol }) => `${count} ${symbol}`).join(), faint: of("vehicles").some(({ id, opacity }) => id === "VID-2" && opacity < 1) };
    });
    await until("the lost one fades", async () => (await shown()).faint);

    // From far: the lost one stays beside the cluster, and so does a selected one.
    await page.evaluate(() => document.querySelector("#fleet-map").fleetMap.map.setZoom(10));
    await until("a cluster", async () => { const { ids, clusters } = await shown(); return ids === "VID-2" && clusters === "2 vehicle-cluster-armed"; });
    if (shots) await page.screenshot({ path: `${shots}/map-cluster.png` });
    await page.click("#vehicle-VID-3 td[data-label=Mode]");
    await until("the selected one is no part of it", async () => { const { ids, clusters } = await shown(); return ids === "VID-1,VID-2,VID-3" && clusters === ""; });
    await page.keyboard.press("Escape");
    await until("the cluster again", async () => (await shown()).clusters !== "");
    // With the keyboard: it is beside the map, says who is inside, and leads to them.
    await page.focus("#fleet-map canvas");
    await page.keyboard.press("Tab");
    equal("its name", await page.evaluate(() => document.activeElement.getAttribute("aria-label")), "2 vehicles, no trouble: zoom in");
    await page.keyboard.press("Enter");
    await until("Enter looks at it from nearer", async () => (await shown()).ids.includes("VID-1,"));
    await until("the focus is on the map", () => page.evaluate(() => document.activeElement.matches("canvas")));
    equal("nothing is selected by it", await selected(page), []);
    await page.evaluate(() => document.querySelector("#fleet-map").fleetMap.map.setZoom(10));
    await until("the cluster once more", async () => (await shown()).clusters !== "");
    // One that is out of view has no button to get to.
    await page.evaluate(() => document.querySelector("#fleet-map").fleetMap.map.jumpTo({ center: [20, 47.39] }));
    await until("its button is away", async () => (await page.$$(".map-cluster:not([hidden])")).length === 0);
    await page.evaluate(() => document.querySelector("#fleet-map").fleetMap.map.jumpTo({ center: [8.54, 47.39] }));
    await until("the cluster is in view", async () => (await shown()).clusters !== "");
    const at = await page.evaluate(() => {
      const { map } = document.querySelector("#fleet-map").fleetMap;
      const box = map.getCanvas().getBoundingClientRect();
      const { x, y } = map.project(map.queryRenderedFeatures({ layers: ["vehicles-cluster"] })[0].geometry.coordinates);
      return [box.x + x, box.y + y];
    });
    await page.mouse.click(...at);
    await until("a click looks at it from nearer", async () => (await shown()).ids.includes("VID-1,"));
    equal("and selects nothing", await selected(page), []);
  },

  // Figures of many vehicles that change five times a second.
  async fleet() {
    const page = await open();
    await ready(page);
    const number = Number(count);
    const all = () => until(`${number} vehicles are drawn`, async () => Object.keys(await drawn(page)).length >= number * 0.9);
    await all();
    // Of the page's thread; what software WebGL takes is another process's.
    const session = await page.context().newCDPSession(page);
    await session.send("Performance.enable", { timeDomain: "threadTicks" });
    const spent = async () => Object.fromEntries((await session.send("Performance.getMetrics")).metrics.map(({ name, value }) => [name, value]));
    let before;
    const measure = () => page.evaluate(async () => {
      const hook = document.querySelector("#fleet-map").fleetMap;
      const draw = hook.vehiclesLayer.draw.bind(hook.vehiclesLayer);
      let pushes = 0;
      hook.vehiclesLayer.draw = (fleet) => { pushes += 1; draw(fleet); };
      const frames = [];
      const from = performance.now();
      let last = from;
      // Ten seconds, and longer where software WebGL leaves the page no time in between.
      await new Promise((resolve) => {
        const over = (now) => (now - from > 10_000 && pushes >= 10) || now - from > 300_000;
        const frame = (now) => { frames.push(now - last); last = now; over(now) ? resolve() : requestAnimationFrame(frame); };
        requestAnimationFrame(frame);
      });
      frames.sort((a, b) => a - b);
      const at = (share) => Math.round(frames[Math.floor(frames.length * share)]);
      const seconds = (performance.now() - from) / 1000;
      return { seconds, pushes_per_s: pushes / seconds, frames_per_s: frames.length / seconds, frame_ms: { p50: at(0.5), p95: at(0.95), p99: at(0.99), worst: Math.round(frames.at(-1)) } };
    });
    // On a computer that is too busy LiveView's client loads the page again: the measurement begins again.
    const since = Date.now();
    let figures;
    while (!figures) {
      before = await spent();
      try { figures = await measure(); } catch (error) {
        if (Date.now() - since > PATIENCE_MS || !/context was destroyed/.test(error.message)) throw error;
        console.log(`loaded again after ${Date.now() - since} ms: ${trouble.splice(0).join(", ")}`);
        await ready(page);
        await all();
      }
    }
    const after = await spent();
    for (const name of ["TaskDuration", "ScriptDuration", "LayoutDuration", "RecalcStyleDuration"])
      figures[`${name}_ms_per_s`] = Math.round((1000 * (after[name] - before[name])) / figures.seconds);
    console.log(JSON.stringify(figures));
    if (figures.seconds > 300) throw new Error("the map is not told of what moves");
    if (shots) await page.screenshot({ path: `${shots}/fleet-${number}.png` });
  },

  // Tiles of a PMTiles file: of images, or `water` of vectors.
  async tiles() {
    const page = await open();
    await ready(page);
    await until("the tiles are drawn", () => page.evaluate((kind) => {
      const { map } = document.querySelector("#fleet-map").fleetMap;
      if (!map.isSourceLoaded("tiles")) return false;
      if (kind === "raster") return map.getLayer("tiles")?.type === "raster" && map.areTilesLoaded();
      return map.queryRenderedFeatures({ layers: ["tiles-water"] }).length > 0;
    }, count));
    equal("what the source says", await page.evaluate(() => {
      const { minzoom, maxzoom, type } = document.querySelector("#fleet-map").fleetMap.map.getSource("tiles");
      return [type, minzoom, maxzoom];
    }), [count, 0, 0]);
    if (count === "vector") {
      const of = (layer, property) => page.evaluate(([layer, property]) => document.querySelector("#fleet-map").fleetMap.map.getPaintProperty(layer, property), [layer, property]);
      equal("what the style does not know is a line", await of("tiles-line-waterway", "line-width"), 1);
      const fonts = await page.evaluate(() => JSON.stringify(document.querySelector("#fleet-map").fleetMap.map.getStyle().layers));
      equal("no fonts or pictures of a server", /Noto Sans (Regular|Medium|Italic|Dev)|"icon-image":(?!\["get","symbol"\])/.test(fonts), false);
      await until("the town's name is drawn", () => page.evaluate(() => document.querySelector("#fleet-map").fleetMap.map.queryRenderedFeatures({ layers: ["tiles-places_locality"] }).length > 0));
      if (shots) await page.screenshot({ path: `${shots}/map-vector-light.png` });
      const light = await of("tiles-water", "fill-color");
      await page.evaluate(() => { document.documentElement.dataset.theme = "dark"; window.dispatchEvent(new CustomEvent("theme")); });
      await until("its colours are dark", async () => (await of("tiles-water", "fill-color")) !== light);
    }
    if (shots) await page.screenshot({ path: `${shots}/fleet-tiles.png` });
  },

  // A file that cannot be read: the map does without.
  async notiles() {
    const page = await open();
    await ready(page);
    equal("no tiles", await page.evaluate(() => document.querySelector("#fleet-map").fleetMap.map.getSource("tiles") ?? null), null);
    equal("the reason", complaints.splice(0).filter((text) => text.startsWith("map: the tiles cannot be read")).length, 1);
  },

  // Without a layer: an admin (`count`) is asked and says yes, others are told.
  async base() {
    const page = await open();
    const foreign = [];
    page.on("request", (request) => { if (new URL(request.url()).origin !== new URL(url).origin && !request.url().startsWith("blob:")) foreign.push(request.url()); });
    await page.reload();
    await ready(page);
    const question = page.locator(".map-panel[data-name=map-question]");
    await question.waitFor();
    if (shots) await page.screenshot({ path: `${shots}/map-question-${name}.png` });
    if (count !== "admin") {
      equal("what others are told", /admin can choose/.test(await question.textContent()), true);
      equal("what others can press", await question.locator("button, a").allTextContents(), ["Hide"]);
      await question.locator("button").click();
      await page.reload();
      await ready(page);
      equal("it is said once", await question.count(), 0);
      return;
    }
    equal("the choices", await question.locator("button, a").allTextContents(), ["Use OpenStreetMap", "Stay without"]);
    const other = await open("/plan");
    await other.waitForSelector(".map-panel[data-name=map-question]");
    // One line at the map's lower edge.
    const [line, whole] = [await other.locator(".map-panel").boundingBox(), await other.locator("#plan-map").boundingBox()];
    equal("one line", [line.height < 44, whole.y + whole.height - line.y - line.height < 12], [true, true]);
    await question.getByLabel("Open a file…").setInputFiles({ name: "bad.pmtiles", mimeType: "", buffer: Buffer.from("SQLite format 3\0") });
    await until("why it is not taken", async () => /MBTiles/.test(await page.textContent(".map-panel")));
    complaints.length = 0; // the browser names the refusal
    await page.click(".map-panel button");

    await question.getByText("Use OpenStreetMap").click();
    await until("the tiles are drawn", () => page.evaluate(() => {
      const { map } = document.querySelector("#fleet-map").fleetMap;
      return map.getLayer("tiles")?.type === "raster" && map.isSourceLoaded("tiles") && map.areTilesLoaded();
    }));
    equal("the question is gone", await question.count(), 0);
    // Another page learns of it without being loaded again, and later of the removal.
    await other.waitForSelector(".map-panel[data-name=map-question]", { state: "detached" });
    await until("the other page's attribution", async () => (await other.textContent(".map-attribution")) === "© OpenStreetMap contributors");
    equal("the attribution", await page.textContent(".map-attribution"), "© OpenStreetMap contributors");
    if (shots) await page.screenshot({ path: `${shots}/map-osm.png` });
    await page.click("[data-tool=layers]");
    await page.getByText("Stop using OpenStreetMap").click();
    for (const [one, id] of [[page, "#fleet-map"], [other, "#plan-map"]])
      await until("no tiles", () => one.evaluate((id) => !document.querySelector(id).fleetMap.map.getSource("tiles"), id));
    await page.click("[data-tool=layers]");
    await page.getByText("Use OpenStreetMap for all").click();
    await until("the attribution again", () => page.isVisible(".map-attribution"));
    equal("requests to other hosts", foreign, []);
  },

  // Several layers, the first of which is called `count`: the keyboard chooses none, and that is remembered.
  async layers() {
    const page = await open();
    await ready(page);
    const tiles = () => page.evaluate(() => document.querySelector("#fleet-map").fleetMap.map.getSource("tiles") !== undefined);
    equal("a layer is there", await tiles(), true);
    await page.focus("[data-tool=layers]");
    await page.keyboard.press("Enter");
    equal("the choices", await page.locator(".map-panel label").allTextContents(), [count, "None"]);
    if (shots) await page.screenshot({ path: `${shots}/map-layers.png` });
    await page.keyboard.press("ArrowDown");
    await until("no layer", async () => !(await tiles()));
    equal("no attribution", await page.isVisible(".map-attribution"), false);
    await page.keyboard.press("Escape");
    equal("closed", await page.locator(".map-panel").count(), 0);
    equal("the focus is back", await page.evaluate(() => document.activeElement.dataset.tool), "layers");
    await page.reload();
    await ready(page);
    equal("remembered", await tiles(), false);
    await page.click("[data-tool=layers]");
    await page.getByText(count).click();
    await until("the layer again", tiles);
  },

  // An admin fetches the tiles of what is in view; with the keyboard.
  async area() {
    const page = await open();
    await ready(page);
    await page.evaluate(() => document.querySelector("#fleet-map").fleetMap.map.jumpTo({ center: [8.5, 47.3], zoom: 10 }));
    await page.click("[data-tool=layers]");
    await page.getByText("Prepare an area…").press("Enter");
    const panel = page.locator(".map-panel[data-name=map-area]");
    const says = (words) => until(words, async () => words.test(await panel.textContent()));
    await says(/What is in view: \d+ tiles, about \d+ MB|Not possible: /);
    equal("the zoom has the focus", await page.evaluate(() => document.activeElement.type), "number");
    await page.keyboard.press("Control+a");
    await page.keyboard.type("11");
    await page.keyboard.press("Tab");
    await says(/What is in view: \d{2} tiles, about 1 MB/);
    if (shots) await page.screenshot({ path: `${shots}/map-area.png` });
    await page.keyboard.press("Enter");
    await says(/Fetched: (\d+) of \1 tiles/);
    const outlines = () => page.evaluate(() => {
      const { map } = document.querySelector("#fleet-map").fleetMap;
      return map.getSource("areas") ? map.querySourceFeatures("areas").map(({ properties }) => properties.text) : [];
    });
    await until("the map shows where it is", async () => (await outlines()).includes("Prepared to zoom 11"));
    await page.getByText("Back").click();
    equal("the layers again", await page.locator(".map-panel[data-name=map-layers]").count(), 1);
  },

  // An admin opens the file `count`, sees it, and removes it.
  async upload() {
    const page = await open();
    await ready(page);
    await page.locator(".map-panel").getByLabel("Open a file…").setInputFiles(count);
    const drawn = () => page.evaluate(() => { const { map } = document.querySelector("#fleet-map").fleetMap; return map.getLayer("tiles")?.type === "raster" && map.areTilesLoaded(); });
    await until("the file is drawn", drawn);
    equal("the question is gone", await page.locator(".map-panel").count(), 0);
    await page.click("[data-tool=layers]");
    equal("the choices", await page.locator(".map-panel label:has([type=radio])").allTextContents(), ["own", "None"]);
    page.once("dialog", (dialog) => dialog.accept());
    await page.getByText("Remove own").click();
    await until("it is gone", async () => !(await drawn()) && page.locator(".map-panel[data-name=map-question]").isVisible());
  },

  async missing() {
    const page = await open();
    await ready(page);
    await until("the map says it", async () => /cannot fetch/.test(await page.textContent(".map-status")));
    complaints.length = 0; // the browser names each
  },

  async nowebgl() {
    const page = await open();
    await page.waitForSelector("#fleet-map.map-failed");
    equal("the notice", /WebGL/.test(await page.textContent(".map-notice")), true);
    equal("rows", (await page.$$("#fleet-table tbody tr")).length, 3);
    await page.click("#vehicle-VID-1 td[data-label=Mode]");
    await until("the table works", async () => (await selected(page)).join() === "VID-1");
  },
};

let status = 0;
try {
  await tasks[task]();
  // Software WebGL says that it is slow.
  const other = complaints.filter((text) => !/GPU stall|WebSocket|swiftshader|SwiftShader|GroupMarkerNotSet|WebGL/i.test(text));
  if (other.length) throw new Error(`complaints of the browser:\n${other.join("\n")}`);
  console.log("ok");
} catch (error) {
  console.log(error.stack, complaints);
  status = 1;
}
await browser.close();
process.exit(status);
