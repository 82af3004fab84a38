// The replay by mouse and keyboard. Arguments: the console's address, and the second at which the flights ended.
import { contains, equal, live, main, open, until } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const [base, end] = [process.argv[2], Number(process.argv[3])];
const iso = (at) => new Date(at * 1000).toISOString().replace(".000Z", "Z");
const clock = (at) => new Date(at * 1000).toISOString().slice(11, 19);
const now = (page) => page.$eval("#replay-line svg", (svg) => Number(svg.getAttribute("aria-valuenow")));
const shown = (page, ids) => until(page, (ids) => document.querySelector("#replay").dataset.shown === ids, ids);

main(async (browser) => {
  const page = await open(browser, { viewport: { width: 1280, height: 900 }, colorScheme: "dark" });
  await signIn(page, base, "operator", `/replay?at=${iso(end - 400)}`);
  await until(page, () => document.querySelectorAll("#replay-line .name").length === 2);
  equal("the time of the address", await now(page), end - 400);
  await contains(page, "#replay-badge", `REPLAY ${clock(end - 400)}`);
  await contains(page, "#replay-badge", "min");
  await shown(page, "eagle,kite");
  equal("buttons that command", await page.locator("#replay .hold-button, #replay [phx-hook=HoldButton]").count(), 0);
  // Shift and Escape abort what flies now; they do not lead away.
  await page.keyboard.press("Shift+Escape");
  equal("still the replay", new URL(page.url()).pathname, "/replay");
  equal("frame", await page.$eval("#replay", (el) => getComputedStyle(el).borderTopColor), await page.$eval("#replay-badge", (el) => getComputedStyle(el).color));

  // A gap is a gap: the eagle is nowhere, on the map and on the time line.
  await page.focus("#replay-line svg");
  const slider = page.locator("#replay-line svg");
  for (let minute = 0; minute < 2; minute += 1) await page.keyboard.press("PageDown");
  equal("two minutes on", await now(page), end - 280);
  await shown(page, "kite");
  await until(page, () => {
    const air = [...document.querySelectorAll("#replay-line .air")].map((rect) => [Number(rect.getAttribute("x")), Number(rect.getAttribute("x")) + Number(rect.getAttribute("width"))]);
    const x = Number(document.querySelector("#replay-line .cursor").getAttribute("x1"));
    return air.length >= 2 || !air.some(([from, to]) => x > from + 1 && x < to - 1);
  });

  // From event to event.
  await page.keyboard.press("ArrowLeft");
  equal("the event before", await now(page), end - 400);
  await contains(page, "#replay-card", "failsafe");
  await page.keyboard.press("ArrowRight");
  equal("the next one", await now(page), end - 30);
  await contains(page, "#replay-card", "landed");
  await page.keyboard.press("ArrowRight");
  await contains(page, "#replay-card", "geofence");
  await contains(page, "#replay-card", "By ann");
  await contains(page, "#replay-card", "Audit, record");
  await page.keyboard.press("Home");
  await page.keyboard.press("ArrowLeft");
  await contains(page, "#replay-card", "No earlier event");

  // The wheel zooms, a click and a drag scrub.
  await page.keyboard.press("End");
  const span = () => page.$eval("#replay", ({ dataset }) => dataset.view.split(" ")[1] - dataset.view.split(" ")[0]);
  equal("a day", await span(), 86_400);
  for (let times = 0; times < 40 && (await span()) > 900; times += 1) await page.keyboard.press("+");
  await slider.hover();
  const wide = await span();
  await page.mouse.wheel(0, -200);
  await until(page, (wide) => {
    const [from, to] = document.querySelector("#replay").dataset.view.split(" ");
    return to - from < wide;
  }, wide);
  const box = await slider.boundingBox();
  await page.mouse.click(box.x + box.width - 200, box.y + 10);
  const clicked = await now(page);
  await page.mouse.move(box.x + box.width - 200, box.y + 10);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width - 300, box.y + 10, { steps: 4 });
  await page.mouse.up();
  if (!((await now(page)) < clicked)) throw new Error("a drag to the left goes back");
  equal("zooms to a minute", await (async () => { for (let n = 0; n < 20; n += 1) await page.keyboard.press("+"); return span(); })(), 60);

  // It plays, at speed, and stops at its end.
  await page.keyboard.press("Home");
  const before = await now(page);
  await page.selectOption("[data-speed]", "60");
  await page.focus("#replay-line svg");
  await page.keyboard.press(" ");
  await until(page, (before) => Number(document.querySelector("#replay-line svg").getAttribute("aria-valuenow")) > before + 60, before);
  await page.keyboard.press(" ");
  const paused = await now(page);
  await until(page, (at) => location.search.includes(encodeURIComponent(at).replaceAll("%3A", ":")), iso(paused).slice(0, 16));
  equal("play is off", await page.getAttribute("[data-play]", "aria-pressed"), "false");
  if (!(await page.$eval("#replay-line svg", (svg) => svg.getAttribute("aria-valuetext"))).includes("UTC")) throw new Error("the slider says no time");

  // Some vehicles at the same second, all again; a link to the record of the audit log.
  const chosen = iso(await now(page));
  await page.click("summary:has-text('Vehicles: all')");
  await page.check("input[name=vehicle][value=kite]");
  await page.click("button:has-text('Show these')");
  await until(page, () => [...document.querySelectorAll("#replay-line .name")].map(({ textContent }) => textContent).join() === "kite");
  equal("the same second", iso(await now(page)), chosen);
  await page.click("summary:has-text('Vehicles: 1 of 2')");
  await page.uncheck("input[name=vehicle][value=kite]");
  await page.click("button:has-text('Show these')");
  await until(page, () => document.querySelectorAll("#replay-line .name").length === 2);
  await page.focus("#replay-line svg");
  await page.keyboard.press("End");
  await page.keyboard.press("ArrowLeft");
  await until(page, () => /^\/audit\?record=\d+$/.test(document.querySelector("#replay-card a")?.getAttribute("href") ?? ""));

  // On a phone, light; Escape goes back to what is live.
  await page.setViewportSize({ width: 390, height: 844 });
  await page.emulateMedia({ colorScheme: "light" });
  await until(page, () => document.documentElement.scrollWidth <= 390);
  await page.keyboard.press("Escape");
  await page.waitForURL(base + "/");
  await live(page);
  equal("complaints", page.complaints.join("\n"), "");
});
