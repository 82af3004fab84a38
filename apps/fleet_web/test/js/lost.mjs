// The gateway goes away and comes back. Argument: the console's address. It prints what it has seen, and the test acts in between.
import { createInterface } from "node:readline";
import { equal, live, main, open } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const base = process.argv[2];
const lines = createInterface({ input: process.stdin })[Symbol.asyncIterator]();
const told = async (word) => equal("told", (await lines.next()).value, word);

main(async (browser) => {
  const page = await open(browser);
  await signIn(page, base, "operator", "/vehicles/VID-007");
  await page.evaluate(() => { window.same = true; });
  console.log("ready");

  await told("gone");
  await page.waitForSelector("#gateway-lost:not([hidden])");
  console.log("lost");
  // The page cannot be used, not even by force.
  // The key is dealt with when it has been pressed: a button that it holds says so at once.
  await page.keyboard.down("l");
  equal("a held button", await page.locator("#action-land").getAttribute("data-state"), null);
  await page.keyboard.up("l");

  console.log("tried");
  await told("back");
  await page.waitForSelector("#gateway-lost", { state: "hidden" });
  await live(page);
  equal("the page was not loaded again", await page.evaluate(() => window.same), true);
  console.log("back");
});
