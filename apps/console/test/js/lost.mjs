// The gateway goes away and comes back. Argument: the console's address. It prints what it has seen, and the test acts in between.
import { createInterface } from "node:readline";
import { equal, live, main, open, shows } from "../../../../test/browser/chromium.mjs";
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
  await shows(page, "#hint", "Nothing is sent while the gateway is lost.");

  // What the page is when the banner goes: joined again, and with the values of now.
  await page.evaluate(() => {
    const banner = document.getElementById("gateway-lost");
    window.back = [];
    new MutationObserver(() => {
      if (!banner.hidden) return;
      window.back.push(document.querySelector("[data-phx-main]").classList.contains("phx-connected"));
      window.back.push(document.querySelector(".main").textContent.includes("BRAKE"));
    }).observe(banner, { attributeFilter: ["hidden"] });
  });
  console.log("tried");
  await told("back");
  await page.waitForSelector("#gateway-lost", { state: "hidden" });
  await live(page);
  equal("the page was not loaded again", await page.evaluate(() => window.same), true);
  equal("what is there when the banner goes", JSON.stringify(await page.evaluate(() => window.back)), "[true,true]");
  console.log("back");
});
