// The gateway is killed while somebody looks at a vehicle, and started again. Argument: the address that signs in. It prints what it has seen,
// and the test acts in between.
import { createInterface } from "node:readline";
import { equal, hold, live, main, open, SMALL } from "./chromium.mjs";

const [address] = process.argv.slice(2);
const lines = createInterface({ input: process.stdin })[Symbol.asyncIterator]();
const told = async (word) => equal("told", (await lines.next()).value, word);

main(async (browser) => {
  const page = await open(browser, { viewport: SMALL, reducedMotion: "reduce" });
  await page.goto(address);
  await live(page);
  await page.locator("#fleet-table .fleet-name a").first().click();
  await page.waitForURL("**/vehicles/*");
  await live(page);
  await page.evaluate(() => { window.same = true; });
  await hold(page, "#action-hold");
  await page.waitForSelector("#commands-now .life:not(.busy)");
  console.log("held");

  await told("killed");
  await page.waitForSelector("#gateway-lost:not([hidden])");
  // A key that is pressed now must not be sent later.
  await page.keyboard.down("l");
  equal("a held button", await page.locator("#action-land").getAttribute("data-state"), null);
  await page.keyboard.up("l");
  console.log("lost");

  await told("back");
  await page.waitForSelector("#gateway-lost", { state: "hidden" });
  await live(page);
  // The page shows the vehicle again by itself.
  await page.waitForSelector(".vehicle-head[data-status=online]");
  await page.waitForSelector("#vehicle-map.map-ready");
  equal("the page was not loaded again", await page.evaluate(() => window.same), true);
  // The browser logs each failed attempt to connect.
  const others = page.complaints.filter((text) => !/WebSocket|ERR_CONNECTION/.test(text));
  equal("complaints", JSON.stringify(others), "[]");
});
