// The room of the fleet's map and table: the bar between them, the key \\, a phone. Argument: the console's address.
import { contains, equal, live, main, open, until } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const base = process.argv[2];
const width = (page) => page.evaluate(() => Math.round(document.querySelector("#fleet-map").getBoundingClientRect().width));
const share = (page) => page.getAttribute(".fleet-bar", "aria-valuenow").then(Number);
const selected = (page) => page.evaluate(() => [...document.querySelectorAll("#fleet-table tr[aria-selected=true]")].map((row) => row.dataset.id).join());
const wider = (page, than) => until(page, (than) => document.querySelector("#fleet-map").getBoundingClientRect().width > than, than);

main(async (browser) => {
  const page = await open(browser, { viewport: { width: 1280, height: 800 } });
  await signIn(page, base, "operator");
  await live(page);
  await page.click("#vehicle-V02 td[data-label=Mode]");
  await contains(page, "#fleet-actions", "V02");

  // By keyboard, and by pointer.
  const first = await width(page);
  const told = await share(page);
  await page.focus(".fleet-bar");
  await page.keyboard.press("ArrowRight");
  await wider(page, first);
  equal("two per cent more", await share(page), told + 2);
  await page.keyboard.press("End");
  equal("at most", await share(page) <= 80, true);
  await page.keyboard.press("Home");
  equal("at least", await share(page), 20);
  equal("the map", await width(page) < first, true);
  const bar = await page.locator(".fleet-bar").boundingBox();
  await page.mouse.move(bar.x + 4, 400);
  await page.mouse.down();
  await page.mouse.move(700, 400, { steps: 4 });
  await page.mouse.up();
  await wider(page, first);
  const kept = await width(page);
  equal("where it was dropped", Math.abs(kept - (700 - 56)) < 12, true);
  equal("the selection", await selected(page), "V02");
  await page.reload();
  await live(page);
  equal("after a reload", await width(page), kept);

  // A row that has the focus gives it away before it disappears; the dock stays, and says who is selected.
  await page.click("#vehicle-V03 td[data-label=Mode]");
  await contains(page, "#fleet-actions", "V03");
  await page.keyboard.press("\\");
  await wider(page, 1200);
  equal("the table", await page.isVisible("#fleet-list"), false);
  equal("the focus", await page.evaluate(() => document.activeElement.closest("#fleet-split") !== null), true);
  await contains(page, ".fleet-selected", "V03");
  await page.reload();
  await live(page);
  await wider(page, 1200);
  equal("says so", await page.getAttribute("#fleet-split button", "aria-expanded"), "false");
  await page.click("#fleet-split button");
  await page.waitForSelector("#fleet-list");
  equal("as before", await width(page), kept);
  // Where somebody types it is a letter.
  await page.focus("#fleet-search");
  await page.keyboard.type("\\");
  equal("typed", await page.inputValue("#fleet-search"), "\\");
  equal("still there", await page.isVisible("#fleet-list"), true);
  equal("no complaints", JSON.stringify(page.complaints), "[]");
  await page.context().close();

  const phone = await open(browser, { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true });
  await signIn(phone, base, "operator");
  await phone.waitForSelector("#fleet-table tbody tr");
  await live(phone);
  const seen = await phone.evaluate(() => {
    const box = document.querySelector("#fleet-table").getBoundingClientRect();
    const rows = [...document.querySelectorAll("#fleet-table tbody tr")].map((row) => row.getBoundingClientRect());
    const inside = rows.filter(({ top, bottom }) => top >= box.top && bottom <= box.bottom + 1);
    const map = document.querySelector("#fleet-map").getBoundingClientRect();
    const cut = [...document.querySelectorAll("#fleet-table tbody :is(th, td)")].filter((cell) => cell.scrollWidth > cell.clientWidth);
    return { rows: inside.length, heights: [...new Set(rows.map(({ height }) => height))].join(), map: map.height / document.querySelector(".fleet").offsetHeight,
      cut: cut.map((cell) => cell.textContent.trim()).join(), wide: document.documentElement.scrollWidth, dock: document.querySelector(".fleet-dock").offsetHeight };
  });
  equal("rows in sight", seen.rows >= 5, true);
  equal("of one height", seen.heights, "64");
  equal("the map's share", seen.map > 0.4 && seen.map < 0.5, true);
  equal("cut", seen.cut, "");
  equal("as wide as the phone", seen.wide, 390);
  equal("no dock", seen.dock, 0);
  await phone.tap("button[popovertarget=fleet-filter]");
  await phone.tap("#fleet-filter [phx-value-flag=stale]");
  await contains(phone, ".fleet-count", "1 of 14");
  await phone.keyboard.press("Escape");
  equal("filters", await phone.isVisible("#fleet-search"), false);
  equal("says so", await phone.getAttribute("button[popovertarget=fleet-filter]", "aria-pressed"), "true");
  await phone.tap("#vehicle-V07 td.fleet-check input");
  await phone.waitForSelector("#fleet-hold");
  const reach = await phone.locator("#fleet-hold").boundingBox();
  equal("in a thumb's reach", reach.y > 844 * 0.6, true);
  equal("no complaints", JSON.stringify(phone.complaints), "[]");
  await phone.context().close();

  // A viewer is told so, and why there are no buttons.
  const viewer = await open(browser, { viewport: { width: 390, height: 844 } });
  await signIn(viewer, base, "viewer");
  await live(viewer);
  equal("the role", await viewer.isVisible("#user-menu summary .badge"), true);
  await viewer.click("#vehicle-V07 td.fleet-check input");
  await contains(viewer, "#fleet-actions", "Viewers watch. Ask an operator or admin for more.");
  equal("nothing to hold", await viewer.locator(".fleet-dock .hold").count(), 0);
});
