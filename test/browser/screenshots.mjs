// The pictures of README.md and docs/console.md. Arguments: the address that signs in, the key of a program, the folder
// for them, and words of which the names of those to take have one; without words all are taken.
import { statSync } from "node:fs";
import { contains, equal, live, main, open, until } from "./chromium.mjs";

const [address, key, folder, ...wanted] = process.argv.slice(2);
const MOST_BYTES = 300_000;
const VEHICLES = 6;
const looks = {
  wide: { viewport: { width: 1440, height: 900 } },
  phone: { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true, deviceScaleFactor: 2 },
};
// So long that vehicles draw a track.
const TRACKS_MS = 15_000;
// So long before the picture is what the replay shows.
const HISTORY_MS = 60_000;
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
const vehicle = (n) => `sim-${String(n).padStart(3, "0")}`;

// A mission around the field, and a fence, as a file that the page of plans opens.
function plan() {
  const item = (command, north, east, up, params = [0, 0, 0, null]) => ({
    type: "SimpleItem", autoContinue: true, command, frame: 3, params: [...params, 47.397742 + north / 111_320, 8.545594 + east / 75_360, up],
  });
  const corner = (north, east) => [47.397742 + north / 111_320, 8.545594 + east / 75_360];
  return {
    fileType: "Plan", version: 1, groundStation: "Aerie",
    mission: {
      version: 2, firmwareType: 3, vehicleType: 2, cruiseSpeed: 15, hoverSpeed: 5, plannedHomePosition: [...corner(0, 0), 489],
      items: [item(22, 0, 0, 20), item(16, 120, 20, 30), item(16, 150, 150, 45), item(19, 60, 210, 60, [30, 0, 0, null]), item(16, -60, 160, 35), item(21, 0, 20, 0)],
    },
    geoFence: { version: 2, circles: [], polygons: [{ version: 1, inclusion: true, polygon: [corner(-130, -80), corner(230, -80), corner(230, 290), corner(-130, 290)] }] },
    rallyPoints: { version: 2, points: [[...corner(-80, -20), 20]] },
  };
}

const mapDrawn = (page) => until(page, () => {
  const all = [...document.querySelectorAll(".map:not(.map-failed)")].filter((map) => map.offsetParent);
  return all.every(({ fleetMap }) => fleetMap?.map.isSourceLoaded("tiles") && fleetMap.map.areTilesLoaded());
});
const rows = (page) => until(page, (n) => document.querySelectorAll("#fleet-table tr[data-id]").length >= n, VEHICLES);

// One vehicle after the other returns; slowly, so that it runs while the pictures are taken.
async function operation(origin) {
  const vehicles = Array.from({ length: VEHICLES }, (_, n) => vehicle(n + 1));
  const body = JSON.stringify({ id: "home", name: "Return", vehicles, step: 1, pause_s: 60, command: { type: "rtl" } });
  const headers = { "x-aerie-key": key, "content-type": "application/json" };
  const answer = await fetch(`${origin}/api/operations`, { method: "POST", headers, body });
  if (!answer.ok && answer.status !== 409) throw new Error(`the operation: ${answer.status} ${await answer.text()}`);
}

// What a picture shows, in the order in which they are taken: `looks` are those that the documents show.
const scenes = {
  vehicle: {
    path: `/vehicles/${vehicle(1)}`, looks: ["wide-light", "phone-dark"],
    ready: () => pause(TRACKS_MS),
    last: (page) => contains(page, ".vehicle-air", "Flying"),
  },
  plan: {
    path: `/plan?vehicle=${vehicle(1)}`, looks: ["wide-light", "phone-light"],
    async ready(page) {
      const file = { name: "field.plan", mimeType: "application/json", buffer: Buffer.from(JSON.stringify(plan())) };
      await page.setInputFiles("#plan-import", file);
      await page.waitForSelector("#plan-items > li:nth-child(6)");
      await page.click("#plan-items > li:nth-child(4) .plan-pick");
      await page.waitForSelector("#plan-item-3");
    },
  },
  fleet: {
    path: "/", looks: ["wide-dark", "wide-light", "phone-light"],
    async ready(page) {
      await rows(page);
      await pause(TRACKS_MS);
    },
  },
  operation: {
    path: "/", looks: ["wide-light", "wide-dark", "phone-dark"], before: operation,
    async ready(page) {
      await rows(page);
      await page.waitForSelector("#operation-stop-home, [phx-value-operation=home]");
      await pause(TRACKS_MS);
    },
  },
  replay: {
    path: () => `/replay?at=${new Date(Date.now() - HISTORY_MS).toISOString()}`,
    looks: ["wide-light", "phone-light"], before: () => pause(HISTORY_MS),
    async ready(page) {
      await until(page, (n) => document.querySelectorAll("#replay-line .name").length >= n, VEHICLES);
      await page.focus("#replay-line svg");
      for (let times = 0; times < 7; times += 1) await page.keyboard.press("+");
      await page.waitForFunction(() => document.querySelector("#replay").dataset.shown);
    },
  },
};

main(async (browser) => {
  const first = await open(browser, looks.wide);
  await first.goto(address);
  await live(first);
  const origin = new URL(first.url()).origin;
  const cookies = await first.context().cookies();
  await first.context().close();

  for (const [scene, { path, looks: shown, before, ready, last }] of Object.entries(scenes)) {
    const take = (name) => !wanted.length || wanted.some((word) => name.includes(word));
    const names = shown.map((look) => `${scene}-${look}`).filter(take);
    if (names.length) await before?.(origin);
    for (const name of names) {
      const [width, colorScheme] = name.slice(scene.length + 1).split("-");
      const page = await open(browser, { ...looks[width], colorScheme });
      await page.context().addCookies(cookies);
      await page.goto(origin + (typeof path === "string" ? path : path()));
      await live(page);
      await ready(page);
      await mapDrawn(page);
      await pause(2_000);
      // It may have moved.
      await mapDrawn(page);
      await last?.(page);
      await shot(page, `${folder}/${name}.png`);
      equal("complaints", JSON.stringify(page.complaints), "[]");
      await page.context().close();
    }
  }
});

async function shot(page, path) {
  await page.screenshot({ path });
  const { size } = statSync(path);
  if (size > MOST_BYTES) throw new Error(`${path} has ${size} bytes, more than ${MOST_BYTES}`);
  console.log(`${path} ${size}`);
}
