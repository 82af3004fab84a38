// A mode of several vehicles, or their missions one after the other: one changes under the hand, and the page is killed in the middle.
// Arguments: the console's address, and which of both.
import { contains, equal, hold, live, main, open, shows } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";
import { say, underHand } from "./told.mjs";

const [base, task] = process.argv.slice(2);
const STRIP = "#operation-strip";

const tasks = {
  async mode(page) {
    await page.focus("#fleet-mode summary");
    await page.keyboard.press("Enter");
    await contains(page, "#fleet-mode", "ArduPilot: AUTO");
    await underHand(page, "#fleet-mode-mission", ["holding", "changed"], () => contains(page, "#fleet-mode", "PX4: AUTO_MISSION"));
    // With a PX4 among them, Guided says why it is not set.
    await contains(page, "#fleet-mode", "PX4 flies OFFBOARD only while it gets set-points");
    equal("refused", await page.getAttribute("#fleet-mode-guided", "aria-disabled"), "true");
    await say("ended", "begin");
    await hold(page, "#fleet-mode-mission");
    return ["Mode Mission 3: 2 in the mode, 1 setting the mode", "Mode Mission 3: all in the mode"];
  },

  async start(page) {
    await page.click("#fleet-actions button:has-text('Start 3 missions')");
    await shows(page, "#start-title", "Start the missions of 3 vehicles");
    await page.fill("#start-interval", "0");
    await contains(page, "#start-V3", "+0 s");
    await underHand(page, "#start-go", ["holding", "changed"], () => contains(page, "#start", "V3 is not in the air: leave it out."));
    await page.focus("#start-V3 button:has-text('Leave out')");
    await page.keyboard.press("Enter");
    await contains(page, "#start-go", "Start 2, one after the other");
    await say("ended", "begin");
    await hold(page, "#start-go");
    await page.waitForSelector("#start", { state: "detached" });
    return ["Start missions 2: 1 flying the mission, 1 starting the mission", "Start missions 2: all flying the mission"];
  },
};

main(async (browser) => {
  const page = await open(browser, { viewport: { width: 1280, height: 900 } });
  await signIn(page, base, "operator");
  await page.waitForSelector("#vehicle-V3");
  await page.click(".fleet-groups button[phx-value-name=all]");
  const [middle, end] = await tasks[task](page);
  await contains(page, STRIP, middle);
  await say("begun", "killed");
  await live(page);
  await contains(page, STRIP, middle);
  await say("back", "done");
  await contains(page, STRIP, end);
  equal("no complaints", JSON.stringify(page.complaints), "[]");
});
