// The palette, the search and the skip links, by the keyboard alone. Argument: the console's address.
import { contains, equal, live, main, open, shows, until } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const base = process.argv[2];
const address = (page) => page.url().slice(base.length);
const first = "#palette [aria-selected=true]";

async function find(page, words, label, note) {
  await page.keyboard.press("Control+k");
  await page.waitForSelector("#palette[open]");
  await page.keyboard.type(words);
  await until(page, ([first, label, note]) => {
    const option = document.querySelector(first);
    return option?.children[0].textContent === label && option.children[1].textContent.includes(note);
  }, [first, label, note]);
}

async function go(page, to) {
  await page.keyboard.press("Enter");
  await page.waitForURL(base + to);
  await live(page);
  await page.waitForSelector("#palette:not([open])", { state: "attached" });
}

main(async (browser) => {
  const page = await open(browser);
  await signIn(page, base, "operator");
  await page.evaluate(() => { window.same = true; });
  await find(page, "007", "VID-007", "online");
  await go(page, "/vehicles/VID-007");
  await find(page, "go to", "Go to", "command of VID-007");
  await go(page, "/vehicles/VID-007/commands?c=goto");
  await page.waitForSelector("#command-form-goto");
  await find(page, "events", "Events", "VID-007");
  await go(page, "/vehicles/VID-007/events");
  await page.keyboard.press("/");
  equal("the search has the focus", await page.evaluate(() => document.activeElement.id), "events-search");
  // Also where somebody types; arrows go round; what is found is text, whatever it says.
  await find(page, "<i>", "V<i>8", "online");
  equal("no markup", await page.locator("#palette li i").count(), 0);
  await page.keyboard.press("Control+a");
  await page.keyboard.type("V");
  await until(page, () => document.querySelectorAll("#palette li").length > 2);
  await page.keyboard.press("ArrowUp");
  await until(page, () => document.querySelector("#palette li:last-child").getAttribute("aria-selected") === "true");
  equal("what is read out", await page.evaluate(() => document.getElementById(document.querySelector("#palette input").getAttribute("aria-activedescendant")) === document.querySelector("#palette li:last-child")), true);
  equal("bounded", (await page.locator("#palette li").count()) <= 20, true);
  // Keys that command are the palette's own while it is open.
  await page.keyboard.down("h");
  await page.keyboard.up("h");
  equal("no press", await page.evaluate(() => document.querySelector("#action-hold").dataset.state ?? null), null);
  await page.keyboard.type("nothing of this name");
  await shows(page, "#palette [role=status]", "Nothing has this name.");
  await page.keyboard.press("Escape");
  await page.waitForSelector("#palette:not([open])", { state: "attached" });
  await find(page, "rtl_alt", "RTL_ALT", "parameters of VID-007");
  await go(page, "/params?vehicle=VID-007&search=rtl_alt");
  equal("the search of parameters", await page.inputValue("#params-search").catch(() => "rtl_alt"), "rtl_alt");
  equal("the page was not loaded again", await page.evaluate(() => window.same), true);

  // Skip links that lead somewhere.
  await page.goto(base + "/vehicles/VID-007");
  await live(page);
  await page.waitForSelector("#action-arm:enabled, .hold:enabled");
  await page.focus(".skip.to-actions");
  await page.keyboard.press("Enter");
  equal("to the actions", await page.evaluate(() => document.activeElement.matches("#main .hold")), true);
  equal("no table here", await page.isVisible(".skip.to-table"), false);
  equal("the address stays", address(page), "/vehicles/VID-007");
  await page.goto(base + "/");
  await live(page);
  await page.focus(".skip.to-table");
  await page.keyboard.press("Enter");
  equal("to the table", await page.evaluate(() => document.activeElement.matches("#fleet-table tr")), true);

  // The names of the navigation lie over the page while the pointer is there, and move nothing.
  const where = await page.locator("#main").boundingBox();
  await page.hover(".nav .nav-link >> nth=1");
  await until(page, () => document.querySelector(".nav").getBoundingClientRect().width > 150);
  equal("the page's place", JSON.stringify(await page.locator("#main").boundingBox()), JSON.stringify(where));

  const viewer = await open(browser);
  await signIn(viewer, base, "viewer", "/vehicles/VID-007");
  await find(viewer, "rtl", "RTL", "parameters of VID-007");
  equal("no commands for a viewer", await viewer.locator("#palette li").count(), 1);
  await contains(viewer, "#palette", "parameters");
  equal("complaints", JSON.stringify([...page.complaints, ...viewer.complaints]), "[]");
});
