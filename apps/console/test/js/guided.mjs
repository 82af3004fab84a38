// A place on the map: its menu by mouse, keyboard and touch, on the fleet's and the vehicle's page; a box that selects. Argument: the
// console's address. VID-007 and VID-008 are 33 m apart.
import { contains, equal, hold, live, main, open, SMALL, until } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const base = process.argv[2];
const ready = (page, id, count) => until(page, ([id, count]) => document.querySelector(`#${id}.map-ready`)?.fleetMap?.fleet.size === count, [id, count]);
const menu = (page) => page.$$eval(".map-menu [role=menuitem]", (items) => items.map((item) => `${item.firstChild.textContent}${item.ariaDisabled === "true" ? " (no)" : ""}`).join(", "));
const selected = (page, ids) => until(page, (ids) => [...document.querySelectorAll("#fleet-table tr[aria-selected=true]")].map(({ dataset }) => dataset.id).join() === ids, ids);
const gone = (page) => until(page, () => !document.querySelector(".map-menu"));
const ALL = "Go here, Land here, Look here, Orbit (no), Set home (no), Measure from here";

main(async (browser) => {
  const page = await open(browser, { viewport: SMALL });
  await signIn(page, base, "operator", "/");
  await ready(page, "fleet-map", 2);
  const box = await page.locator("#fleet-map canvas").boundingBox();
  const middle = { x: box.x + box.width / 2, y: box.y + box.height / 2 };

  // A box around all adds, with Alt it removes; a click with Shift is a click.
  const drag = async (keys) => {
    for (const key of keys) await page.keyboard.down(key);
    await page.mouse.move(box.x + 5, box.y + 5);
    await page.mouse.down();
    await page.mouse.move(middle.x, middle.y);
    await page.mouse.move(box.x + box.width - 70, box.y + box.height - 5);
    await page.waitForSelector(".map-box");
    await page.mouse.up();
    for (const key of keys) await page.keyboard.up(key);
  };
  const view = await page.evaluate(() => JSON.stringify(document.querySelector("#fleet-map").fleetMap.map.getCenter()));
  await drag(["Shift"]);
  await selected(page, "VID-007,VID-008");
  await contains(page, "#fleet-map .map-status", "2 vehicles in the box, added to the selection.");
  await drag(["Alt", "Shift"]);
  await selected(page, "");
  await contains(page, "#fleet-map .map-status", "removed from the selection");
  equal("the map stays", await page.evaluate(() => JSON.stringify(document.querySelector("#fleet-map").fleetMap.map.getCenter())), view);

  // Without one vehicle a place can be measured from, and the menu says why no more.
  await page.mouse.click(middle.x, middle.y, { button: "right" });
  await contains(page, ".map-menu-note", "Select one vehicle");
  equal("for no vehicle", await menu(page), "Measure from here");
  await page.keyboard.press("Escape");
  await gone(page);

  // By the menu key at the centre; what the firmware lacks has its reason and does nothing.
  await page.click("#vehicle-VID-007 td[data-label=Mode]");
  await selected(page, "VID-007");
  await until(page, () => document.querySelector("#fleet-map").dataset.menu.includes("VID-007"));
  await page.focus("#fleet-map canvas");
  await page.keyboard.press("ContextMenu");
  await contains(page, ".map-menu-title", "VID-007");
  equal("for a copter", await menu(page), ALL);
  for (let n = 0; n < 3; n += 1) await page.keyboard.press("ArrowDown");
  await contains(page, ".map-menu-item:focus", "Not available");
  await page.keyboard.press("Enter");
  await page.keyboard.press("ArrowUp");
  await page.keyboard.press("Enter");

  // It leads to the vehicle's page, where it is held; loaded again, the page prepares nothing.
  await contains(page, "#target-title", "Look at a place");
  await until(page, () => location.pathname === "/vehicles/VID-007" && location.search === "");
  await ready(page, "vehicle-map", 1);
  await hold(page, "#action-set_roi");
  await contains(page, "#commands-now .life", "Set region of interest");
  await page.reload();
  await live(page);
  await ready(page, "vehicle-map", 1);
  equal("no card", await page.locator("#target-title").count(), 0);

  // By the mouse: the line, the circle, and what the card says are of this place.
  await page.locator("#vehicle-map canvas").click({ button: "right", position: { x: 300, y: 120 } });
  await page.click(".map-menu [data-act=goto]");
  await page.waitForSelector(".goto-panel [data-answer=allow]");
  const shown = () => page.evaluate(() => document.querySelector("#vehicle-map").fleetMap.overlays.parts.target.map(({ properties }) => `${properties.kind} ${properties.text ?? ""}`).join(", "));
  await until(page, () => document.querySelector("#vehicle-map").fleetMap.overlays.parts.target.length === 4);
  equal("line and circle", /^target go here, way \d+ m(, \d+ s)?, ring , ring 20 m high$/.test(await shown()), true);
  await page.fill("#goto-altitude", "31");
  await page.fill("#goto-speed", "0.5");
  await until(page, () => document.querySelector("#vehicle-map").fleetMap.overlays.parts.target.at(-1).properties.text === "31 m high");
  await until(page, () => / away, \d+ (s|min)/.test(document.querySelector(".goto-panel .mono").textContent));
  if (process.env.AERIE_SHOTS) await page.screenshot({ path: `${process.env.AERIE_SHOTS}/guided.png` });
  await page.click(".goto-panel button[aria-label=Cancel]");
  await until(page, () => document.querySelector("#vehicle-map").fleetMap.overlays.parts.target.length === 0);
  equal("complaints of the browser", JSON.stringify(page.complaints), "[]");

  // A finger that rests; one that moves does not ask.
  const phone = await open(browser, { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true });
  await signIn(phone, base, "operator", "/vehicles/VID-007");
  await ready(phone, "vehicle-map", 1);
  const at = await phone.locator("#vehicle-map canvas").boundingBox();
  const point = { x: at.x + 60, y: at.y + at.height / 2 };
  const touch = await phone.context().newCDPSession(phone);
  const finger = (type, points) => touch.send("Input.dispatchTouchEvent", { type, touchPoints: points });
  await finger("touchStart", [point]);
  await phone.waitForSelector(".map-menu");
  await finger("touchEnd", []);
  equal("for a finger", await menu(phone), ALL);
  await phone.tap(".map-menu [data-act=set_roi]");
  await contains(phone, "#target-title", "Look at a place");
  equal("no scrolling sideways", await phone.evaluate(() => document.documentElement.scrollWidth), 390);

  // A viewer measures, and commands nothing.
  const viewer = await open(browser, { viewport: SMALL });
  await signIn(viewer, base, "viewer", "/vehicles/VID-007");
  await ready(viewer, "vehicle-map", 1);
  await viewer.focus("#vehicle-map canvas");
  await viewer.keyboard.press("Shift+F10");
  await contains(viewer, ".map-menu-note", "can only watch");
  equal("for a viewer", await menu(viewer), "Measure from here");
  await viewer.keyboard.press("Enter");
  await until(viewer, () => document.querySelector("#vehicle-map").fleetMap.measure.points.length === 1);
});
