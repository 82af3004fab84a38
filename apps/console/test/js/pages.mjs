// Every page, narrow and wide, dark and light: no complaint of the browser, nothing wider than the window, nothing serious by axe, no more than
// 300 kB to load without the map. Arguments: the console's address, the paths of the pages.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { equal, live, main, open } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const [base, ...paths] = process.argv.slice(2);
const axe = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const MOST_BYTES = 300_000;
const map = /maplibre-gl|world-atlas|topojson|\/map\/|tiles/;

const looks = [
  { viewport: { width: 390, height: 844 }, colorScheme: "light", hasTouch: true, isMobile: true },
  { viewport: { width: 1440, height: 900 }, colorScheme: "dark" },
];

main(async (browser) => {
  const found = [];
  for (const look of looks) {
    const page = await open(browser, look);
    await signIn(page, base, "admin");
    for (const path of paths) {
      const where = `${path} at ${look.viewport.width}`;
      const sizes = [];
      const loaded = (request) => {
        if (!map.test(request.url())) sizes.push(request.sizes().then((sizes) => sizes.responseBodySize).catch(() => 0));
      };
      page.on("requestfinished", loaded);
      await page.goto(base + path);
      await live(page);
      await page.waitForLoadState("networkidle");
      page.off("requestfinished", loaded);
      const bytes = (await Promise.all(sizes)).reduce((sum, size) => sum + size, 0);
      if (bytes > MOST_BYTES) found.push(`${where}: ${bytes} bytes`);

      const wide = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
      if (wide > 0) found.push(`${where}: ${wide} px wider than the window`);

      for (const text of page.complaints.splice(0)) found.push(`${where}: ${text}`);
      await page.evaluate(axe);
      const { violations } = await page.evaluate(() => window.axe.run(document, { resultTypes: ["violations"] }));
      for (const { id, impact, nodes } of violations) {
        if (["serious", "critical"].includes(impact)) {
          found.push(`${where}: ${impact} ${id}: ${nodes.slice(0, 3).map((node) => node.html.slice(0, 160)).join(" | ")}`);
        }
      }
      // Axe tries styles that the policy forbids.
      page.complaints.splice(0);
    }
  }
  equal("findings", found.join("\n"), "");
});
