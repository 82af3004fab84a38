// Pictures of the console's pages, wide and on a phone, dark and light. Arguments: the address that signs in, and the folder for them.
import { statSync } from "node:fs";
import { contains, equal, hold, live, main, open, until } from "./chromium.mjs";

const [address, folder] = process.argv.slice(2);
const MOST_BYTES = 300_000;
const VEHICLES = 6;
const looks = {
  wide: { viewport: { width: 1440, height: 900 } },
  phone: { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true, deviceScaleFactor: 2 },
};
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
  return all.every(({ fleetMap }) => fleetMap?.map.isSourceLoaded("land") && fleetMap.map.querySourceFeatures("land").length > 0);
});

// What each page is to show, once it lives.
const scenes = {
  fleet: {
    path: "/", map: true,
    async ready(page) {
      await until(page, (n) => document.querySelectorAll("#fleet-table tr[data-id]").length >= n, VEHICLES);
      await pause(15_000); // tracks
    },
  },
  vehicle: {
    path: `/vehicles/${vehicle(1)}`, map: true,
    async ready(page) {
      await contains(page, ".vehicle-air", "Flying");
      await pause(8_000); // a track
    },
  },
  plan: {
    path: `/plan?vehicle=${vehicle(1)}`, map: true,
    async ready(page) {
      const file = { name: "field.plan", mimeType: "application/json", buffer: Buffer.from(JSON.stringify(plan())) };
      await page.setInputFiles("#plan-import", file);
      await page.waitForSelector("#plan-items > li:nth-child(6)");
      await page.click("#plan-items > li:nth-child(4) .plan-pick");
      await page.waitForSelector("#plan-item-3");
    },
  },
  "vehicle-commands": { path: `/vehicles/${vehicle(1)}/commands?c=goto` },
  "vehicle-charts": {
    path: `/vehicles/${vehicle(1)}/charts?f=position.alt_rel,velocity.groundspeed,battery.voltage`,
    ready: () => pause(15_000), // samples
  },
  "vehicle-health": { path: `/vehicles/${vehicle(1)}/health` },
  params: { path: `/params?vehicle=${vehicle(1)}`, ready: (page) => page.waitForSelector("#params") },
  inspector: {
    path: "/inspector",
    async ready(page) {
      await page.click("#messages button.link-button:text-is('ATTITUDE')");
      await contains(page, "pre.hex", "FD ");
      await pause(3_000);
    },
  },
};

main(async (browser) => {
  // What the pages tell of: a command, users.
  const first = await open(browser, { ...looks.wide, reducedMotion: "reduce" });
  await first.goto(address);
  await live(first);
  const origin = new URL(first.url()).origin;
  const cookies = await first.context().cookies();
  await first.goto(`${origin}/vehicles/${vehicle(VEHICLES)}/events`);
  await live(first);
  await hold(first, "#action-hold");
  const links = await first.$$eval(".nav .nav-link", (all) => all.map((a) => new URL(a.href).pathname));
  await first.goto(`${origin}/settings`);
  await live(first);
  for (const [name, role] of [["ann", "operator"], ["bob", "viewer"]]) {
    if ((await first.locator(`#user-${name}`).count()) > 0) continue;
    await first.fill("#new-name", name);
    await first.selectOption("#new-role", role);
    await first.fill("#new-password", crypto.randomUUID());
    await first.click("#add-user button[type=submit]");
    await first.waitForSelector(`#user-${name}`);
  }
  await first.context().close();

  // Pages without a map first: they take little time.
  const all = [...others(links), ...Object.entries(scenes)];
  for (const maps of [false, true]) {
    for (const [width, options] of Object.entries(looks)) {
      for (const colorScheme of ["dark", "light"]) {
        const name = (scene) => `${folder}/${scene}-${width}-${colorScheme}.png`;
        const look = { ...options, colorScheme, reducedMotion: "reduce" };
        const page = await open(browser, look);
        if (!maps) {
          await page.goto(`${origin}/sign-in`);
          await shot(page, name("sign-in"));
        }
        await page.context().addCookies(cookies);
        for (const [scene, { path, ready, map = false }] of all) {
          if (map !== maps) continue;
          await page.goto(origin + path);
          await live(page);
          await ready?.(page);
          await until(page, () => !document.querySelector("#main .spinner"));
          if (map) await mapDrawn(page);
          await pause(2_000);
          await shot(page, name(scene));
        }
        equal("complaints", JSON.stringify(page.complaints), "[]");
        await page.context().close();
      }
    }
  }
});

// The pages of the navigation that are no scene.
function others(links) {
  const known = ["/", ...Object.values(scenes).map(({ path }) => path.split("?")[0])];
  return links.filter((path) => !known.includes(path)).map((path) => [path.slice(1).replaceAll("/", "-"), { path }]);
}

async function shot(page, path) {
  await page.screenshot({ path });
  const { size } = statSync(path);
  if (size > MOST_BYTES) throw new Error(`${path} has ${size} bytes, more than ${MOST_BYTES}`);
  console.log(`${path} ${size}`);
}
