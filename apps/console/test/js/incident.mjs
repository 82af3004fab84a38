// An incident packed from the replay: refused for a day, packed for some minutes, refused by what packs it; operators see why they cannot.
// Arguments: the console's address, and the second at which the flights ended.
import { contains, equal, main, open, until } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const [base, end] = [process.argv[2], Number(process.argv[3])];
const iso = (at) => new Date(at * 1000).toISOString().replace(".000Z", "Z");

main(async (browser) => {
  const page = await open(browser, { viewport: { width: 1280, height: 900 } });
  await signIn(page, base, "admin", `/replay?at=${iso(end - 400)}`);
  await until(page, () => document.querySelectorAll("#replay-line .name").length === 2);
  await page.click("summary:has-text('Incident…')");
  await page.click("[data-incident] button");
  await contains(page, "[data-packing]", "longer than 2 hours: zoom in (+), or use aerie incident");

  const span = () => page.$eval("#replay", ({ dataset }) => dataset.view.split(" ")[1] - dataset.view.split(" ")[0]);
  await page.focus("#replay-line svg");
  for (let times = 0; times < 40 && (await span()) > 900; times += 1) await page.keyboard.press("+");
  await page.selectOption("[data-incident] select", "kite");
  const [download] = await Promise.all([page.waitForEvent("download"), page.click("[data-incident] button")]);
  equal("its name", download.suggestedFilename(), "incident-kite.tar.gz");
  await contains(page, "[data-packing]", "incident-kite.tar.gz, 2.0 MB");
  equal("again", await page.isEnabled("[data-incident] button"), true);

  await page.selectOption("[data-incident] select", "eagle");
  console.log("asks");
  await page.click("[data-incident] button");
  await contains(page, "[data-packing]", "Packing… reading eagle.tlog");
  console.log("packing");
  await contains(page, "[data-packing]", "nothing is known of eagle");
  // The refusals, which the browser logs by itself.
  equal("complaints of the browser", page.complaints.every((text) => text.includes("Failed to load resource")), true);

  const operator = await open(browser, { viewport: { width: 1280, height: 900 } });
  await signIn(operator, base, "operator", "/replay");
  await operator.click("summary:has-text('Incident…')");
  await contains(operator, "#replay-incident", "Only an admin packs it");
  equal("no button", await operator.locator("[data-incident]").count(), 0);
  equal("by its address", await operator.evaluate((end) => fetch(`/download/incident?vehicle=kite&from=${end - 60}&to=${end}`).then(({ status }) => status), end), 403);
});
