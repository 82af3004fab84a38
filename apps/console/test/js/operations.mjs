// Operations at the foot of every page, and what ends all flights at its head. Arguments: the server's address, and what to do.
import { contains, equal, hold, holdKey, live, main, open, slip, until } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const [base, task] = process.argv.slice(2);
const STRIP = "#operation-strip";

const tasks = {
  async strip(page) {
    await contains(page, STRIP, "Take off 3: 1 climbing, 2 waiting");
    // By keyboard: the list of the vehicles, and the first button.
    await page.focus("#operation-vehicles-up summary");
    await page.keyboard.press("Enter");
    await page.waitForSelector("#operation-up li >> text=Climbing 0 m");
    await page.keyboard.press("Tab");
    await page.focus(`${STRIP} button >> text=Pause`);
    await page.keyboard.press("Enter");
    await contains(page, STRIP, "Take off 3, paused");
    // It stays open, and its list is not closed by what changes.
    equal("open", await page.evaluate(() => document.querySelector("#operation-vehicles-up").open), true);
    // A press that is too short begins nobody.
    await slip(page, "#operation-continue-up");
    await contains(page, STRIP, "paused");
    await hold(page, "#operation-continue-up");
    await contains(page, STRIP, "Take off 3: 1 climbing, 2 waiting");
    await page.goto(base + "/alarms");
    await live(page);
    await page.click(`${STRIP} button >> text=Stop`);
    await contains(page, STRIP, "2 stopped");
  },

  async abort(page) {
    await page.goto(base + "/settings");
    await live(page);
    await contains(page, "#abort-hold", "Hold 3");
    // Escape alone is for dialogs and menus, and does nothing here.
    await page.keyboard.down("Escape");
    equal("not held", await page.evaluate(() => document.querySelector("#abort-hold").dataset.state === "holding"), false);
    await page.keyboard.up("Escape");
    await page.keyboard.down("Shift");
    await holdKey(page, "#abort-hold", "Escape");
    await page.keyboard.up("Shift");
    await contains(page, STRIP, "Hold all 3:");
    await page.click("#abort-menu summary");
    await hold(page, "#abort-rtl");
    await contains(page, STRIP, "Return all 3:");
    // A phone has both within its width.
    await page.setViewportSize({ width: 390, height: 844 });
    const wider = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
    equal("not wider than 390 px", wider, 0);
    await page.waitForSelector("#abort-menu[open]");
    for (const id of ["abort-hold", "abort-menu", "abort-rtl", "abort-land"]) {
      await until(page, (id) => { const { left, right } = document.getElementById(id).getBoundingClientRect(); return left >= 0 && right > left && right <= 390; }, id);
    }
    await page.click("#abort-menu summary");
    await page.waitForSelector("#abort-menu:not([open])");
  },
};

main(async (browser) => {
  const page = await open(browser);
  await signIn(page, base, "operator");
  await tasks[task](page);
  await page.close();
});
