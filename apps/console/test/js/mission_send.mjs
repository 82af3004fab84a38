// Missions to several vehicles: a file, the tick, one that lands under the hand, the page killed in the middle, and the draft of Plan.
// Arguments: the console's address, and a plan's file.
import { contains, equal, hold, live, main, open, shows, slip, until } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";
import { previewed, say, underHand } from "./told.mjs";

const [base, file] = process.argv.slice(2);
const open4 = "#fleet-actions button:has-text('Mission to 4')";
const closed = (page) => page.waitForSelector("#mission", { state: "detached" });

main(async (browser) => {
  const page = await open(browser, { viewport: { width: 1280, height: 900 } });
  await signIn(page, base, "operator");
  await page.waitForSelector("#vehicle-V4");
  await page.click(".fleet-groups button[phx-value-name=all]");
  await page.click(open4);
  await shows(page, "#mission-title", "Mission to 4 vehicles");
  await contains(page, "#mission", "Choose a file");

  // Without a draft it says so; a file is compared beside the page.
  await page.focus("#mission-files [data-draft]");
  await page.keyboard.press("Enter");
  await contains(page, "#mission-files", "This tab has no draft");
  await page.setInputFiles("#mission-file", file);
  await contains(page, "#mission-files", "field.plan, 3 items");
  await contains(page, "#mission", "V4: Betaflight has no missions");
  await page.focus("#mission-V4 button:has-text('Leave out')");
  await page.keyboard.press("Enter");

  // All at the same place: near, and only with a tick, by the keyboard alone.
  await page.fill("#mission-interval", "0");
  await contains(page, "#mission-files", "Nearest 0.0 m at 00:50 between V1 and V2");
  await contains(page, "#mission", "tick it");
  await page.focus("#mission-agree");
  await page.keyboard.press("Space");
  await until(page, () => !document.querySelector("#mission-go").dataset.refusal);
  await slip(page, "#mission-go");

  // Beside each other: nothing is left to agree to, and the map shows the ways.
  await page.selectOption("#mission-how", "offset");
  await page.fill("#mission-east", "0");
  await page.fill("#mission-north", "20");
  await contains(page, "#mission-V3", "+40 m N, +6 m up");
  await until(page, () => !document.querySelector("#mission-agree") && !document.querySelector("#mission-go").dataset.refusal);
  await previewed(page, "way,1,way,2,way,3");

  await underHand(page, "#mission-go", ["holding", "landed"], () => contains(page, "#mission-V3", "its way to the first place is not compared"));
  await page.click("#mission-V3 button:has-text('Leave out')");
  await contains(page, "#mission-go", "Send to 2");
  await until(page, () => !document.querySelector("#mission-go").dataset.refusal);
  await say("ended", "begin");
  await hold(page, "#mission-go");
  await closed(page);
  await previewed(page, "");
  await contains(page, "#operation-strip", "Send missions 2: all sending");
  await say("begun", "killed");
  await live(page);
  await contains(page, "#operation-strip", "Send missions 2: all sending");

  // The draft that this tab keeps.
  await page.evaluate((text) => sessionStorage.setItem("plan", text), JSON.stringify({
    fileType: "Plan", version: 1, groundStation: "t", geoFence: { circles: [], polygons: [], version: 2 }, rallyPoints: { points: [], version: 2 },
    mission: { version: 2, firmwareType: 3, vehicleType: 2, cruiseSpeed: 5, hoverSpeed: 5, plannedHomePosition: [47, 8, 450],
      items: [{ type: "SimpleItem", autoContinue: true, command: 16, doJumpId: 1, frame: 3, params: [0, 0, 0, null, 47.001, 8, 30] }] },
  }));
  await until(page, () => document.querySelectorAll("#fleet-table tr[aria-selected=true]").length === 4);
  await page.click(open4);
  await page.click("#mission-files [data-draft]");
  await contains(page, "#mission-files", "Draft of Plan, 1 item");
  await page.keyboard.press("Escape");
  await closed(page);

  const viewer = await open(browser, { viewport: { width: 390, height: 844 } });
  await signIn(viewer, base, "viewer");
  await live(viewer);
  await contains(viewer, "#operation-strip", "Send missions 2: all sending");
  await say("back", "done");
  equal("no complaints", JSON.stringify([page.complaints, viewer.complaints]), "[[],[]]");
});
