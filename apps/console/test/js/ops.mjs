// The inspector, the system page and their neighbours in a browser: live, in two widths. Argument: the server's address.
import { contains, equal, live, main, open } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const base = process.argv[2];
const pages = ["/links", "/inspector", "/recordings", "/diagnosis", "/system", "/audit"];

main(async (browser) => {
  for (const width of [390, 1440]) {
    const page = await open(browser, { viewport: { width, height: 844 } });
    await signIn(page, base, "admin");

    for (const path of pages) {
      await page.goto(base + path);
      await live(page);
      const wider = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
      equal(`${path} is not wider than ${width} px`, wider, 0);
    }

    // Messages come while somebody looks; one is chosen, frozen, and its bytes are shown.
    await page.goto(base + "/inspector");
    await live(page);
    await page.waitForSelector("#messages button.link-button");
    await page.click("#messages button.link-button");
    await contains(page, "pre.hex", "FD ");
    await page.click("text=Freeze");
    await page.waitForSelector(".notice.warn");
    await page.click("text=Send a message");
    await page.waitForSelector("dialog[open] #compose-form");
    await page.selectOption("#compose-message", "PARAM_REQUEST_READ");
    await page.fill("#compose-target_system", "300");
    await page.waitForSelector("#compose-target_system-errors");
    await page.keyboard.press("Escape");
    await page.waitForSelector("#compose-form", { state: "detached" });
    await page.close();
  }
});
