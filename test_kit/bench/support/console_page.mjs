// A page of the fleet whose table says when it shows a change: a mode is the time at which it was set. Arguments: the address, the cookie
// (name=value), the time to end at (unix milliseconds). Prints the microseconds that each took.
import { chromium } from "playwright-core";

const [base, cookie, until] = process.argv.slice(2);
const [name, value] = cookie.split("=", 2);
// Software WebGL would take the core that the gateway is to be measured on.
const browser = await chromium.launch({ executablePath: process.env.AERIE_CHROMIUM, args: ["--no-sandbox", "--disable-gpu", "--disable-webgl", "--disable-3d-apis"] });
const context = await browser.newContext({ viewport: { width: 1440, height: 900 } });
await context.addCookies([{ name, value, url: base }]);
const page = await context.newPage();
await page.goto(base);
await page.waitForSelector("[data-phx-main].phx-connected");
await page.evaluate(() => {
  window.late = [];
  const look = (records) => {
    const now = Math.round((performance.timeOrigin + performance.now()) * 1000);
    for (const { target, addedNodes } of records) {
      for (const node of [target, ...addedNodes]) {
        const found = node.nodeType === Node.TEXT_NODE && /^M(\d{16})$/.exec(node.data.trim());
        if (found) window.late.push(now - Number(found[1]));
      }
    }
  };
  new MutationObserver(look).observe(document.querySelector("#fleet-table"), { subtree: true, childList: true, characterData: true });
});
await new Promise((resolve) => setTimeout(resolve, Number(until) - Date.now()));
console.log(JSON.stringify(await page.evaluate(() => window.late)));
await browser.close();
