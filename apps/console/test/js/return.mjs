// The sheet for a return of several vehicles, by mouse and keyboard. Argument: the console's address. It prints what it has done, and the test acts
// in between.
import { contains, equal, hold, live, main, open, shows, slip } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";
import { previewed, say, underHand } from "./told.mjs";

const [base] = process.argv.slice(2);

main(async (browser) => {
  const page = await open(browser, { viewport: { width: 1280, height: 900 } });
  await signIn(page, base, "operator");
  await page.waitForSelector("#vehicle-V3");
  await page.click(".fleet-groups button[phx-value-name=all]");
  // A mode by its meaning: a press that is too short sends nothing.
  await page.focus("#fleet-mode summary");
  await page.keyboard.press("Enter");
  await contains(page, "#fleet-mode", "ArduPilot: GUIDED");
  await slip(page, "#fleet-mode-guided");
  equal("no operation", await page.locator("#operation-strip").count(), 0);
  await page.focus("#fleet-mode summary");
  await page.keyboard.press("Enter");
  // Missions one after the other: the order by hand and by keyboard, and a press that is too short.
  await page.click("#fleet-actions button:has-text('Start 3 missions')");
  await shows(page, "#start-title", "Start the missions of 3 vehicles");
  await page.dragAndDrop("#start-V3 strong", "#start-V1 strong");
  await contains(page, "#start-V3", "+0 s");
  await page.focus("#start-V3 button[aria-label='V3 later']");
  await page.keyboard.press("Enter");
  await contains(page, "#start-V3", "+10 s");
  await slip(page, "#start-go");
  await page.click("#start footer button:has-text('Cancel')");
  await page.waitForSelector("#start", { state: "detached" });
  equal("still no operation", await page.locator("#operation-strip").count(), 0);
  await page.click("#fleet-actions button:has-text('Return 3')");
  await shows(page, "#return-title", "Return 3 vehicles");
  await contains(page, "#return-V2", "One place with V1");
  await page.fill("#return-step", "4");
  await contains(page, "#return-V3", "38 m");
  // What is said of a vehicle is not cut.
  equal("not cut", await page.evaluate(() => [...document.querySelectorAll("#return-lines .badge")].filter((el) => el.scrollWidth > el.clientWidth).length), 0);

  // One lands while the button is held: the press ends, and nothing is sent.
  // The map has the ways home, and what lands at one place with another in red.
  await previewed(page, "way,1: 30 m,conflict,✕ 2: 34 m,way,3: 38 m");
  await underHand(page, "#return-go", ["holding", "landed"], () => contains(page, "#return", "V3 is not in the air: leave it out."));
  console.log("ended");

  // By keyboard: left out, and the rest begins.
  await page.focus("#return-V3 button");
  await page.keyboard.press("Enter");
  await contains(page, "#return-go", "Return 2");
  await hold(page, "#return-go");
  await page.waitForSelector("#return", { state: "detached" });
  await contains(page, "#operation-strip", "Return 2: all changing height");
  await say("begun", "killed");
  await live(page);
  await contains(page, "#operation-strip", "Return 2: all changing height");

  // Another operator sees the same, and a second sheet for them is refused.
  const admin = await open(browser, { viewport: { width: 1280, height: 900 } });
  await signIn(admin, base, "admin");
  await contains(admin, "#operation-strip", "Return 2: all changing height");
  await admin.waitForSelector("#vehicle-V3");
  await admin.click(".fleet-groups button[phx-value-name=air]");
  await admin.click("#fleet-actions button:has-text('Return 2')");
  await hold(admin, "#return-go");
  await contains(admin, "#return", "is part of the operation");
  equal("no complaints", JSON.stringify([page.complaints, admin.complaints]), "[[],[]]");
});
