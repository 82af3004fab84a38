// The sheet for a take-off of several vehicles, by mouse and keyboard. Argument: the console's address. It prints what it has done, and the test acts
// in between.
import { contains, equal, hold, live, main, open, presses, shows, until } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";
import { previewed, say, underHand } from "./told.mjs";

const [base] = process.argv.slice(2);
const order = (page) => page.evaluate(() => [...document.querySelectorAll("#take-off-lines li")].map(({ dataset }) => dataset.id).join());
const ordered = (page, ids) => until(page, (ids) => [...document.querySelectorAll("#take-off-lines li")].map(({ dataset }) => dataset.id).join() === ids, ids);
const selected = (page, n) => until(page, (n) => document.querySelectorAll("#fleet-table tr[aria-selected=true]").length === n, n);
const takeOff = "#fleet-actions button:has-text('Take off')";

main(async (browser) => {
  const page = await open(browser, { viewport: { width: 1280, height: 900 } });
  await signIn(page, base, "operator");
  await page.waitForSelector("#vehicle-V5");

  // A tag's key selects its vehicles, a second press none.
  await page.keyboard.press("1");
  await selected(page, 2);
  await page.keyboard.press("1");
  await selected(page, 0);
  await page.click(".fleet-groups button[phx-value-name=all]");
  await selected(page, 5);

  // What is not ready is named in the dock, by the keyboard alone.
  await page.focus("#fleet-why summary");
  await page.keyboard.press("Enter");
  await contains(page, "#fleet-why", "V5");
  await contains(page, "#fleet-why", "Battery: 10 % left");
  await page.keyboard.press("Enter");

  await page.click(takeOff);
  await shows(page, "#take-off-title", "Take off 5 vehicles");
  equal("from south to north", await order(page), "V1,V2,V3,V4,V5");
  // The reason stands there, and holding does nothing.
  await contains(page, "#take-off", "V5 is not ready: leave it out.");
  await page.hover("#take-off-go");
  await page.mouse.down();
  await page.mouse.up();
  equal("no press began", (await presses(page, "#take-off-go")).ended, 0);
  await page.click("#take-off-V5 button:has-text('Leave out')");
  await contains(page, "#take-off-go", "Take off 4, one after the other");

  // The order by hand and by keyboard.
  await page.dragAndDrop("#take-off-V4 strong", "#take-off-V1 strong");
  await ordered(page, "V4,V1,V2,V3,V5");
  await page.focus("#take-off-V4 button[aria-label='V4 later']");
  await page.keyboard.press("Enter");
  await ordered(page, "V1,V4,V2,V3,V5");
  await page.fill("#take-off-height", "30");
  await contains(page, "#take-off-V4", "33 m");

  // One stops being ready while the button is held: the press ends, and nothing is sent.
  await underHand(page, "#take-off-go", ["holding", "unready"], () => contains(page, "#take-off", "V2 is not ready: leave it out."));
  await previewed(page, "1: 30 m,2: 33 m,✕ 3: 36 m,4: 39 m");
  await say("ended", "ready");
  await until(page, () => !document.querySelector("#take-off-go").dataset.refusal);

  // A short press sends nothing; a long one begins it, and the sheet goes.
  await previewed(page, "1: 30 m,2: 33 m,3: 36 m,4: 39 m");
  await hold(page, "#take-off-go");
  await page.waitForSelector("#take-off", { state: "detached" });
  await previewed(page, "");
  await contains(page, "#operation-strip", "Take off 4:");
  await say("begun", "killed");

  // The page that was killed comes back and shows the same operation, as another operator's does.
  await live(page);
  await contains(page, "#operation-strip", "Take off 4:");
  await say("back", "done");
  await contains(page, "#operation-strip", "Take off 4: all up");

  const admin = await open(browser, { viewport: { width: 390, height: 844 } });
  await signIn(admin, base, "admin");
  await live(admin);
  equal("no dock without a selection on a phone", await admin.isVisible(".fleet-dock"), false);
  await contains(admin, "#operation-strip", "Take off 4: all up");
  equal("no complaints", JSON.stringify([page.complaints, admin.complaints]), "[[],[]]");
});
