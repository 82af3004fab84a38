// What somebody does who sees Aerie for the first time: opens the address that bin/run printed, sees three vehicles fly, takes one over,
// lands it, arms it, takes off, sends it somewhere, and watches it land. Arguments: the address, and a folder for pictures.
import { contains, equal, hold, live, main, open, SMALL, until } from "./chromium.mjs";

const [address, pictures] = process.argv.slice(2);

main(async (browser) => {
  const page = await open(browser, { viewport: pictures ? { width: 1440, height: 900 } : SMALL });
  const picture = (name) => pictures && page.screenshot({ path: `${pictures}/newcomer-${name}.png` });

  // One click: signed in, and the token is not in the address any more.
  await page.goto(address);
  await live(page);
  equal("the address", new URL(page.url()).search, "");

  // Three vehicles fly, in the table and on the map.
  await page.waitForSelector("#fleet-map.map-ready");
  await until(page, () => [...document.querySelectorAll("#fleet-table tr[data-id] .fleet-state")].filter((cell) => cell.textContent.includes("in air")).length === 3);
  await until(page, () => {
    const { map } = document.querySelector("#fleet-map").fleetMap;
    const drawn = map.queryRenderedFeatures({ layers: ["vehicles"] }).map(({ properties }) => properties);
    return new Set(drawn.filter(({ state }) => state === "armed").map(({ id }) => id)).size === 3;
  });
  await picture("fleet");
  console.log("three vehicles fly");

  // A click on its name opens one.
  await page.locator("#fleet-table .fleet-name a").first().click();
  await page.waitForURL("**/vehicles/*");
  await live(page);
  const status = (selector, text) => contains(page, `.vehicle-head ${selector}`, text);
  const shown = (selector) => page.locator(`.vehicle-head ${selector}`).textContent();
  await status(".vehicle-status", "online");

  async function land() {
    await hold(page, "#action-land");
    await status(".vehicle-air", "On the ground");
    await status(".vehicle-armed", "disarmed");
  }

  await land();
  console.log("landed");

  // ArduPilot refuses to arm in LAND.
  if (!(await shown(".vehicle-mode")).includes("GUIDED")) {
    await page.selectOption("#mode-choice", "GUIDED");
    await hold(page, "#action-mode");
    await status(".vehicle-mode", "GUIDED");
  }
  await page.fill("#takeoff-altitude", "15");
  // The vehicle disarms itself after ten seconds on the ground; then it has to be armed again.
  for (let flying = false; !flying; ) {
    await hold(page, "#action-arm");
    await status(".vehicle-armed", "ARMED");
    console.log("armed");
    await hold(page, "#action-takeoff");
    const next = await until(page, () => {
      const head = document.querySelector(".vehicle-head");
      if (head.querySelector(".vehicle-air")?.textContent.includes("Flying")) return "flies";
      return head.querySelector(".vehicle-armed").textContent.includes("disarmed") && "disarmed";
    });
    flying = (await next.jsonValue()) === "flies";
  }
  await until(page, () => /^1[3-7]\./.test(document.querySelector("#fly-line dd").textContent.trim()));
  console.log("in the air");

  // A click on the map gives the place; the page shows that the policy allows it before anything is sent.
  await page.click(".fly-aim button");
  await page.waitForSelector("#vehicle-map.map-ready[data-tool=point]");
  const map = page.locator("#vehicle-map");
  const { width, height } = await map.boundingBox();
  await map.click({ position: { x: width * 0.6, y: height * 0.4 } });
  await page.waitForSelector(".goto-panel [data-answer=allow]");
  await picture("goto");
  const place = await page.$$eval("#goto-form input[type=hidden]", (inputs) => Object.fromEntries(inputs.map(({ name, value }) => [name, Number(value)])));
  await hold(page, "#action-goto");
  await page.waitForSelector("#action-goto", { state: "detached" });
  console.log("sent to", place);
  // Within a few metres, as the map has it.
  await until(page, ({ lat, lon }) => {
    const [vehicle] = document.querySelector("#vehicle-map").fleetMap.fleet.values();
    const [east, north] = [(vehicle.position[0] - lon) * Math.cos((lat * Math.PI) / 180), vehicle.position[1] - lat];
    return Math.hypot(east, north) * 111_320 < 5;
  }, place);
  console.log("there");

  await land();
  await picture("landed");
  equal("complaints", JSON.stringify(page.complaints), "[]");
});
