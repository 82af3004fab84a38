// The replay of 62 vehicles, whose page is killed in the middle. Arguments: the console's address, and the second at which the flights ended. It
// prints what it has done, and the test acts in between.
import { createInterface } from "node:readline";
import { equal, main, open, SMALL, until } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const [base, end] = [process.argv[2], Number(process.argv[3])];
const lines = createInterface({ input: process.stdin })[Symbol.asyncIterator]();
const iso = (at) => new Date(at * 1000).toISOString().replace(".000Z", "Z");
const now = (page) => page.$eval("#replay-line svg", (svg) => Number(svg.getAttribute("aria-valuenow")));
const shown = (page, count) => until(page, (count) => (document.querySelector("#replay").dataset.shown ?? "").split(",").filter(Boolean).length === count, count);

main(async (browser) => {
  const page = await open(browser, { viewport: SMALL });
  // The strip below the fleet's map is folded; it opens the replay at the second that is clicked, or by the keyboard, and stays open.
  await signIn(page, base, "operator", "/");
  const rows = () => page.locator("#time-strip .name").count();
  equal("folded", await page.locator("#time-strip[open]").count(), 0);
  equal("nothing is read", await rows(), 0);
  await page.focus("#time-strip summary");
  await page.keyboard.press("Enter");
  await until(page, () => document.querySelectorAll("#time-strip .name").length === 62);
  const strip = await page.locator("#time-strip svg").last().boundingBox();
  await page.mouse.click(strip.x + strip.width - 108, strip.y + 10);
  await until(page, () => location.pathname === "/replay" && document.querySelectorAll("#replay-line .name").length === 62);
  // A hundred pixels before the end of the day.
  equal("hours before the end", Math.round((end - (await now(page))) / 3600), Math.round((100 * 24) / (strip.width - 128)));
  await page.goto(base + "/");
  await until(page, () => document.querySelectorAll("#time-strip[open] .name").length === 62);
  await page.focus("#time-strip svg[role=slider]");
  await page.keyboard.press("ArrowLeft");
  await page.keyboard.press("Enter");
  await until(page, () => location.pathname === "/replay" && document.querySelectorAll("#replay-line .name").length === 62);
  equal("ten minutes before the end", Math.abs(end - 600 - (await now(page))) < 300, true);

  await page.goto(`${base}/replay?at=${iso(end - 100)}`);
  await until(page, () => document.querySelectorAll("#replay-line .name").length === 62);
  await shown(page, 62);
  await page.focus("#replay-line svg");
  await page.keyboard.press("Shift+ArrowRight");
  equal("a second on", await now(page), end - 99);
  await page.evaluate(() => { window.same = true; });
  console.log("there");
  equal("told", (await lines.next()).value, "killed");
  await page.waitForSelector("[data-phx-main].phx-connected");
  equal("not loaded anew", await page.evaluate(() => window.same), true);
  equal("the same second", await now(page), end - 99);
  // What was not asked for before comes from the new page.
  for (let minute = 0; minute < 4; minute += 1) await page.keyboard.press("PageUp");
  equal("four minutes back", await now(page), end - 339);
  await shown(page, 62);
  equal("complaints", page.complaints.join("\n"), "");
});
