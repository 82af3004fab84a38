// Nothing that says how a vehicle is doing is cut in the fleet's table. Argument: the console's address.
import { equal, live, main, open } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const base = process.argv[2];
// The name's cell has tags, and goes on in its title.
const CELLS = "#fleet-table tbody td:not(.fleet-check)";

main(async (browser) => {
  for (const width of [1280, 1440, 1920]) {
    const page = await open(browser, { viewport: { width, height: 900 } });
    await signIn(page, base, "operator");
    await page.waitForSelector(CELLS);
    const cut = await page.evaluate((cells) => [...document.querySelectorAll(cells)].filter((cell) => {
      // What a cell contains may be wider or higher than the part of it that shows.
      const box = cell.getBoundingClientRect();
      const range = document.createRange();
      range.selectNodeContents(cell);
      const text = range.getBoundingClientRect();
      return text.width > box.width || text.height > box.height || cell.scrollWidth > cell.clientWidth;
    }).map((cell) => `${cell.dataset.label}: ${cell.textContent.trim()}`), CELLS);
    equal(`cut at ${width}`, JSON.stringify(cut), "[]");
    // On a usual screen all columns are in sight.
    if (width >= 1440) equal("in sight", await page.evaluate(() => { const box = document.querySelector("#fleet-table"); return box.scrollWidth - box.clientWidth; }), 0);
    const heights = await page.evaluate(() => [...new Set([...document.querySelectorAll("#fleet-table tbody tr:not(:last-child)")].map((row) => row.offsetHeight))]);
    equal("rows of one height", heights.length === 1 ? 1 : heights.join(), 1);
    // Beside a wide map, one line for each: name, mode in words, charge, height.
    await page.focus(".fleet-bar");
    await page.keyboard.press("End");
    await page.waitForFunction(() => document.querySelector("#fleet-table tbody tr").offsetHeight === 64);
    const short = await page.evaluate(() => [...document.querySelectorAll("#fleet-table tbody :is(th, [data-label=Battery], [data-label=Height])")]
      .filter((cell) => cell.scrollWidth > cell.clientWidth).map((cell) => cell.textContent.trim()));
    equal(`cut in a line at ${width}`, JSON.stringify(short), "[]");
    await page.context().close();
  }
});
