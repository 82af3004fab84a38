// A flight by the keyboard alone, from a mode in which the vehicle cannot be armed; where things stand on a desk and on a phone. Argument: the
// console's address.
import { contains, equal, holdKey, live, main, open, shows, until } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const base = process.argv[2];
const box = (page, selector) => page.locator(selector).boundingBox();
const focused = (page) => page.evaluate(() => document.activeElement.id);

main(async (browser) => {
  const page = await open(browser, { viewport: { width: 1440, height: 900 } });
  await signIn(page, base, "operator", "/vehicles/VID-001");
  await contains(page, ".vehicle-doing", "disarmed");
  const [fly, map, instruments] = [await box(page, ".fly"), await box(page, "#vehicle-map"), await box(page, "#instruments")];
  equal("the map is the largest", map.width > fly.width * 0.6 && map.height > 400, true);
  equal("instruments are over its lower left", instruments.x < map.x + 20 && instruments.y + instruments.height > map.y + map.height - 20, true);

  await page.selectOption("#mode-choice", "LAND");
  await page.focus("#action-mode:not([disabled])");
  await holdKey(page, "#action-mode", " ");
  await contains(page, "#action-arm", "Set GUIDED first");
  const places = async () => Promise.all(["#action-arm", "#action-takeoff", "#mode-choice"].map(async (id) => (await box(page, id)).y));
  const before = JSON.stringify(await places());

  // The key arms, and never sets a mode.
  await page.keyboard.press("a");
  await contains(page, "#hint", "It cannot be armed in LAND. Set GUIDED first.");
  await page.focus("#action-arm");
  await holdKey(page, "#action-arm", " ");
  await until(page, () => document.querySelector("#action-arm").textContent.trim().startsWith("Arm"));
  equal("the focus stays", await focused(page), "action-arm");
  await holdKey(page, "#action-arm", "a");
  await contains(page, ".vehicle-armed", "ARMED");
  await contains(page, "#action-arm", "Disarm");
  equal("the focus stays, armed", await focused(page), "action-arm");
  await page.evaluate(() => { document.getElementById("hint").hidden = true; });
  await page.keyboard.press("a");
  await contains(page, "#hint", "It is armed already.");

  await holdKey(page, "#action-takeoff", "t");
  await contains(page, ".vehicle-air", "Flying");
  await until(page, () => /^(Climbing|Waiting)/.test(document.querySelector(".vehicle-doing").textContent));
  equal("places in the card", JSON.stringify(await places()), before);
  await page.keyboard.press("t");
  await shows(page, "#hint", "It is in the air.");
  await until(page, () => /\d m\b/.test(document.querySelector("#fly-line dd").textContent) && /\d\d:\d\d/.test(document.querySelector("#fly-line").textContent));
  equal("a button says how it is pressed", await page.evaluate(() => document.getElementById(document.querySelector("#action-hold").getAttribute("aria-describedby")).textContent), "Press and hold");

  await page.setViewportSize({ width: 390, height: 844 });
  await page.reload();
  await live(page);
  await page.waitForSelector("#fly-instruments:not([open])");
  const tops = await Promise.all(["#vehicle-map", "#fly-line", "#action-arm", "#charge"].map(async (id) => (await box(page, id)).y));
  equal("map, line, actions, who is in charge", JSON.stringify(tops), JSON.stringify([...tops].sort((a, b) => a - b)));
  equal("the head has two lines", (await box(page, ".vehicle-head")).height <= 110, true);
  equal("no scrolling sideways", await page.evaluate(() => document.documentElement.scrollWidth), 390);
  const line = await box(page, "#fly-line");
  equal("the map and the line's first row are above the actions", line.y + line.height / 2 <= (await box(page, ".vehicle-foot")).y, true);
  if (process.env.AERIE_SHOTS) await page.screenshot({ path: `${process.env.AERIE_SHOTS}/fly-phone.png` });
  await holdKey(page, "#action-land", "l");
  await contains(page, ".vehicle-air", "On the ground");
  equal("complaints of the browser", JSON.stringify(page.complaints), "[]");
});
