// A mission is drawn by hand, changed, judged, sent, compared, read back, saved and opened; a fence beside it. Argument: the console's address.
import { readFileSync } from "node:fs";
import { contains, equal, hold, main, open } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const base = process.argv[2];

main(async (browser) => {
  const page = await open(browser, { viewport: { width: 1440, height: 900 }, reducedMotion: "reduce" });
  await signIn(page, base, "operator", "/plan?vehicle=VID-001");
  await page.waitForSelector("#plan-map.map-ready");
  // The view has come to the vehicle, which is in its middle.
  await page.waitForFunction(() => {
    const { fleet, map } = document.querySelector("#plan-map").fleetMap;
    return fleet.size === 1 && map.getZoom() > 15 && !map.isMoving();
  });

  const box = await page.locator("#plan-map").boundingBox();
  const centre = { x: box.x + box.width / 2, y: box.y + box.height / 2 };
  const click = (x, y) => page.mouse.click(centre.x + x, centre.y + y);
  const count = (selector, n) => page.waitForFunction(([selector, n]) => document.querySelectorAll(selector).length === n, [selector, n]);
  const items = (n) => count("#plan-items > li", n);
  // The plan as the map has it: places of its items.
  const drawn = () => page.evaluate(() => document.querySelector("#plan-map").fleetMap.editor.plan.items.map(({ lat, lon }) => [lat.toFixed(6), lon.toFixed(6)].join()));
  const handles = (n) => page.waitForFunction((n) => {
    // One at the border of two tiles is found in both.
    const found = document.querySelector("#plan-map").fleetMap.map.queryRenderedFeatures({ layers: ["plan-handle"] });
    return new Set(found.map(({ properties }) => JSON.stringify(properties))).size === n;
  }, n);
  // Where something of the plan is on the screen.
  const at = async (what, ...where) => {
    const { x, y } = await page.evaluate(([what, where]) => {
      const { editor, map } = document.querySelector("#plan-map").fleetMap;
      const place = what === "item" ? editor.plan.items[where[0]] : { lat: editor.plan.zones[where[0]].ring[where[1]][0], lon: editor.plan.zones[where[0]].ring[where[1]][1] };
      return map.project([place.lon, place.lat]);
    }, [what, where]);
    return { x: box.x + x, y: box.y + y };
  };
  async function drag(from, to) {
    // What is to be held is drawn there: after a change the map takes a moment, on a busy machine a long one.
    await page.waitForFunction(([x, y]) => {
      const { map } = document.querySelector("#plan-map").fleetMap;
      return map.queryRenderedFeatures([[x - 5, y - 5], [x + 5, y + 5]], { layers: ["plan-handle", "plan-middle"] }).length > 0;
    }, [from.x - box.x, from.y - box.y]);
    await page.mouse.move(from.x, from.y);
    await page.mouse.down();
    await page.mouse.move(to.x, to.y, { steps: 5 });
    await page.mouse.up();
  }
  const near = (what, one, other) => equal(what, Math.hypot(one.x - other.x, one.y - other.y) < 3, true);

  // Clicks add; a handle is dragged; the middle of a leg becomes an item; one is removed and comes back.
  for (const [n, [x, y]] of [[-80, 60], [-80, -60], [80, -60]].entries()) {
    await click(x, y);
    await items(n + 1);
    await handles(n + 1);
  }
  const target = { x: centre.x + 120, y: centre.y + 20 };
  await drag(await at("item", 2), target);
  await page.waitForSelector("#plan-item-2");
  near("the item that was dragged", await at("item", 2), target);
  const [from, to] = [await at("item", 1), await at("item", 2)];
  await drag({ x: (from.x + to.x) / 2, y: (from.y + to.y) / 2 }, { x: centre.x, y: centre.y - 90 });
  await items(4);
  await page.click("button[aria-label='Remove item 1']");
  await items(3);
  await page.click("button:text-is('Undo')");
  await items(4);
  console.log("drawn");

  // The policy answers while it is drawn.
  await page.click("#plan-items > li:nth-child(2) .plan-pick");
  await page.fill("#item-1-z", "150");
  await contains(page, "#plan-problems", "100");
  await page.waitForSelector("#plan-upload[disabled]");
  await page.fill("#item-1-z", "40");
  await page.waitForSelector("#plan-problems", { state: "detached" });
  console.log("judged");

  // A zone around, one corner moved.
  await page.click("button:has-text('Fence (0)')");
  for (const [x, y] of [[-170, -170], [170, -170], [170, 170], [-170, 170]]) await click(x, y);
  await contains(page, "#plan-corners", "Corner 4 of a zone");
  // It is not closed yet, and there again when the page is loaded anew.
  await page.reload();
  await page.waitForSelector("#plan-map.map-ready");
  await contains(page, "#plan-corners", "Corner 4 of a zone");
  await handles(1);
  await click(-170, -170);
  await count("#plan-zones > li", 1);
  await handles(4);
  const corner = await at("zone", 0, 0);
  const further = { x: corner.x - 30, y: corner.y - 20 };
  await drag(corner, further);
  await page.waitForFunction(([x, y]) => {
    const { editor, map } = document.querySelector("#plan-map").fleetMap;
    const [lat, lon] = editor.plan.zones[0].ring[0];
    const now = map.project([lon, lat]);
    return Math.hypot(now.x - x, now.y - y) < 3 && !editor.held;
  }, [further.x - box.x, further.y - box.y]);

  // Sent, and the same on board.
  const over = async (...texts) => {
    await page.waitForSelector("#plan-transfer button[aria-label=Close]");
    const results = await page.$$eval("#plan-transfer li", (all) => all.map((one) => one.textContent));
    equal(`three parts: ${results}`, results.length === 3 && texts.every((text, n) => results[n].includes(text)), true);
    await page.click("#plan-transfer button[aria-label=Close]");
    await page.waitForSelector("#plan-transfer", { state: "detached" });
  };
  await hold(page, "#plan-upload");
  await over("4 items, verified", "4 corners, verified", "not sent: the plan has none");
  await page.click("button:text-is('Compare')");
  await over("the same on board", "the same on board", "the same on board");
  const sent = await drawn();
  console.log("sent");

  // Saved, drawn anew from what is on board, and from the file.
  const [download] = await Promise.all([page.waitForEvent("download"), page.click("[phx-value-format=plan]")]);
  const file = await download.path();
  equal("items of the file", JSON.parse(readFileSync(file, "utf8")).mission.items.length, 4);
  const clear = async () => {
    await page.click("button:has-text('Mission (')");
    await page.click("button:text-is('Clear')");
    await page.waitForSelector("#plan-items", { state: "detached" });
  };
  await clear();
  await page.click("button:text-is('Read')");
  await over("4 items on board", "4 corners on board", "nothing on board");
  await items(4);
  equal("what was read", JSON.stringify(await drawn()), JSON.stringify(sent));
  await clear();
  await page.setInputFiles("#plan-import", { name: "mine.plan", mimeType: "application/json", buffer: readFileSync(file) });
  await items(4);
  equal("what was opened", JSON.stringify(await drawn()), JSON.stringify(sent));

  // A mission without a fence leaves the fence aboard; removing it is an act of its own that names it.
  await page.click("button:has-text('Fence (1)')");
  await page.click("button:text-is('Clear')");
  await count("#plan-zones > li", 0);
  await hold(page, "#plan-upload");
  await over("4 items, verified", "not sent: the plan has none", "not sent: the plan has none");
  await page.click("button:has-text('Remove from vehicle')");
  await contains(page, "#plan-remove", "Remove the fence aboard VID-001: 4 corners");
  await page.waitForSelector("#plan-remove[disabled]");
  console.log("kept");
  equal("complaints", JSON.stringify(page.complaints), "[]");
});
