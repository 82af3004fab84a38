// A parameter is found, set, and is so after a reload. Argument: the console's address.
import { contains, equal, hold, live, main, open, slip } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const base = process.argv[2];

main(async (browser) => {
  const page = await open(browser);
  await signIn(page, base, "admin", "/params?vehicle=VID-001");
  await page.waitForSelector("#params");
  await page.fill("#params-search", "pilot tkoff");
  await page.waitForFunction(() => document.querySelectorAll("#params tbody tr").length === 1);
  await page.click("#param-PILOT_TKOFF_ALT a");
  await page.waitForSelector("dialog[open] #param-form");
  await page.fill("#param-value", "150");
  // Neither a click nor Enter sets it.
  await slip(page, "#param-set");
  await page.press("#param-value", "Enter");
  await page.focus("#param-value");
  equal("nothing was set", await page.locator("#params-commands .life").count(), 0);
  await hold(page, "#param-set");
  await page.waitForSelector("#params-commands .life[data-state=completed]");
  await contains(page, "#param-PILOT_TKOFF_ALT strong", "150");
  await page.reload();
  await live(page);
  await contains(page, "#param-PILOT_TKOFF_ALT strong", "150");
  equal("complaints", JSON.stringify(page.complaints), "[]");
});
