// A flight by the page of a vehicle. Argument: the console's address.
import { contains, equal, hold, holdKey, main, open, press } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const base = process.argv[2];

main(async (browser) => {
  const page = await open(browser, { viewport: { width: 1440, height: 900 } });
  await signIn(page, base, "operator", "/vehicles/VID-001");
  await page.waitForSelector("#instruments svg[aria-label^='roll']:not([aria-label*=unknown])");

  await page.selectOption("#mode-choice", "GUIDED");
  await hold(page, "#action-mode");
  await contains(page, ".vehicle-mode", "GUIDED");
  await hold(page, "#action-arm");
  await contains(page, ".vehicle-armed", "ARMED");

  await page.fill("#takeoff-altitude", "150");
  await hold(page, "#action-takeoff");
  await contains(page, "#commands-now .life[data-state=denied]", "100");
  await page.fill("#takeoff-altitude", "12");
  await hold(page, "#action-takeoff");
  await contains(page, ".vehicle-air", "Flying");

  // A short press does nothing.
  await press(page, "#action-rtl", { brief: true });
  await page.click("button:has-text('Go to…')");
  await page.waitForSelector("#vehicle-map.map-ready[data-tool=point]");
  await page.waitForFunction(() => document.querySelector("#vehicle-map").fleetMap?.fleet.size === 1);
  const map = page.locator("#vehicle-map");
  const box = await map.boundingBox();
  await map.click({ position: { x: box.width / 2 + 40, y: box.height / 2 - 40 } });
  await page.waitForSelector(".goto-panel [data-answer=allow]");
  await page.fill("#goto-altitude", "300");
  await page.waitForSelector(".goto-panel [data-answer=deny]");
  await page.fill("#goto-altitude", "14");
  await page.waitForSelector("#action-goto:not([disabled])");
  await hold(page, "#action-goto");
  await contains(page, "#commands-now .life[data-state=completed]", "Go to");

  // The key, held, in another part of the page.
  await page.click("a.tab:has-text('Events')");
  await page.waitForSelector("#events");
  await page.locator("h1").click();
  await holdKey(page, "#action-land", "l");
  await contains(page, ".vehicle-air", "On the ground");
  await page.waitForFunction(() => !document.querySelector("#events").textContent.includes("RTL"));
  equal("complaints of the browser", JSON.stringify(page.complaints), "[]");
});
