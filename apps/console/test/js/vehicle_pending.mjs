// A command without an end, and a reload; then each part of the page on a phone and on a desk. Argument: the console's address.
import { equal, hold, live, main, open } from "../../../../test/browser/chromium.mjs";
import { Samples } from "../../assets/hooks/chart/samples.js";
import { time } from "../../assets/lib/clock.js";
import { signIn } from "./sign_in.mjs";

const base = process.argv[2];
const parts = ["", "/commands?c=goto", "/events", "/charts?f=battery.voltage,position.alt_rel", "/health", "/links"];
const folder = process.env.AERIE_SCREENSHOTS;

equal("a time of a chart", time(1795790345), "14:39:05");
equal("a time of a chart without seconds", time(1795790345, true), "14:39");

const samples = new Samples(["a", "b"], 4);
samples.push(10, { a: 1, b: 2 });
samples.before([[8, { a: 6 }], [9, { a: 7 }], [10, { a: 9 }], [11, { a: 3 }]]);
equal("history in front, and nothing over what was heard", JSON.stringify(samples.data(["a", "b"])), "[[8,9,10],[6,7,1],[null,null,2]]");
samples.choose(["a", "c"]);
samples.before([[8, { c: 1 }], [9, { c: 2 }], [7, { c: 0 }], [6, { c: 0 }]].sort());
equal("a field chosen later, and the limit", JSON.stringify(samples.data(["a", "c"])), "[[7,8,9,10],[null,6,7,1],[0,1,2,null]]");

main(async (browser) => {
  // The zone and the language of the browser change nothing about times.
  const elsewhere = { timezoneId: "America/New_York", locale: "de-DE" };
  const page = await open(browser, { viewport: { width: 390, height: 844 }, hasTouch: true, ...elsewhere });
  await signIn(page, base, "operator", "/vehicles/VID-007");
  await hold(page, "#action-rtl");
  await page.waitForSelector("#commands-now .life[data-state=pending]");
  await page.reload();
  await live(page);
  await page.waitForSelector("#commands-now .life[data-state=pending]");
  await page.evaluate(() => window.liveSocket?.disconnect());

  for (const [name, size] of [["phone", { width: 390, height: 844 }], ["desk", { width: 1440, height: 900 }]]) {
    await page.setViewportSize(size);
    for (const part of parts) {
      await page.goto(`${base}/vehicles/VID-007${part}`);
      await live(page);
      await page.waitForSelector("#action-land");
      if (part === "") await page.waitForSelector("#vehicle-map.map-ready, #vehicle-map.map-failed");
      if (part.startsWith("/charts")) {
        await page.waitForSelector(".uplot");
        equal("the chart's clock", await page.textContent(".u-legend .u-series .u-label"), "UTC");
      }
      const wide = await page.evaluate(() => document.querySelector("#main").scrollWidth - document.querySelector("#main").clientWidth);
      equal(`${part} is as wide as the ${name}`, wide <= 0, true);
      if (folder) await page.screenshot({ path: `${folder}/vehicle${part.replace(/\?.*/, "").replace("/", "_")}_${name}.png` });
    }
  }
  equal("complaints of the browser", JSON.stringify(page.complaints), "[]");
});
