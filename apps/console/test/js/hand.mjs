// The console under an operator's hand, over a slow line. Arguments: the console's address, and what to do. It prints what it has seen, and the
// test acts in between.
import { createInterface } from "node:readline";
import { contains, equal, hold, live, main, open, presses, shows, until } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const [base, task] = process.argv.slice(2);
const lines = createInterface({ input: process.stdin })[Symbol.asyncIterator]();
const told = async (word) => equal("told", (await lines.next()).value, word);
const say = async (word, answer) => { console.log(word); await told(answer); };

const CHANGED = "The selection changed; nothing was sent.";
const row = (id) => `#vehicle-${id}`;
const mode = (id) => `${row(id)} td[data-label=Mode]`;
const selected = (page, ids) => until(page, (ids) => [...document.querySelectorAll("#fleet-table tr[aria-selected=true]")].map((row) => row.dataset.id).join() === ids, ids);
const order = () => [...document.querySelectorAll("#fleet-table tbody tr")].map((row) => row.dataset.id).join();
const answered = (page) => page.waitForSelector("#fleet-table:not([data-phx-ref-lock])");
const steady = (page) => page.waitForSelector("html:not(.gateway-lost)");
// Where each row is in its box, and each of its cells. A click scrolls the box to what it clicks, on a busy machine also further than it has to.
const places = (page) => page.evaluate(() => JSON.stringify([...document.querySelectorAll("#fleet-table tbody tr")].map((row) => {
  const { scrollLeft, scrollTop } = document.querySelector("#fleet-table");
  const { x, y, width, height } = row.getBoundingClientRect();
  return [row.dataset.id, x + scrollLeft, y + scrollTop, width, height, ...[...row.children].map((cell) => Math.round(cell.getBoundingClientRect().x + scrollLeft))];
})));
// How a press on Hold came to nothing: by the gateway, or in the page.
const refused = (page) => until(page, (text) => {
  const { slip, state } = document.querySelector("#fleet-hold")?.dataset ?? {};
  return document.querySelector("#flash")?.textContent.includes(text) ? "refused" : slip && state !== "holding" ? "ended" : false;
}, CHANGED);

const tasks = {
  // V1 is selected and shown. V2 is clicked, and a press made before the answer comes.
  async press(page) {
    await page.click(mode("V1"));
    await selected(page, "V1");
    await say("ready", "slow");
    // In one go, so that the answer to the click cannot come in between. When a line gets slow, the gateway may seem lost for a moment.
    const press = (id) => page.evaluate((id) => {
      const key = (name) => window.dispatchEvent(new KeyboardEvent(name, { key: "h" }));
      const { dataset } = document.querySelector("#fleet-hold");
      delete dataset.slip;
      document.querySelector(`#vehicle-${id} td[data-label=Mode]`).click();
      key("keydown");
      return dataset.state === "holding";
    }, id);
    let [next, other] = ["V2", "V1"];
    for (;;) {
      await steady(page);
      if (await press(next)) break;
      await selected(page, next);
      [next, other] = [other, next];
    }
    console.log("outcome:", await (await refused(page)).jsonValue());
    await selected(page, next);
    await page.evaluate(() => window.dispatchEvent(new KeyboardEvent("keyup", { key: "h" })));
    await say("refused", "quick");

    // A press that is on when the selection changes ends.
    // On a busy machine the gateway may seem lost for a moment, which ends it as well, or lets none begin: then it is made again.
    for (let slip = null; slip !== "Changed"; ) {
      await selected(page, next);
      await steady(page);
      await page.evaluate(() => { const { dataset } = document.querySelector("#fleet-land"); dataset.hold = "600000"; delete dataset.slip; });
      await page.keyboard.down("l");
      await page.click(mode("V3"));
      await selected(page, "V3");
      await page.keyboard.up("l");
      slip = await page.evaluate(() => document.querySelector("#fleet-land").dataset.slip);
      if (slip !== "Changed") await page.click(mode(next));
    }
    await say("ended", "go on");
    await hold(page, "#fleet-rtl");
    await page.waitForSelector("#operation-strip li", { state: "attached" });
    equal("of the one that is shown", await page.locator("#operation-strip li a").first().textContent(), "V3");
  },

  // Rows keep their places under the pointer, and what appears moves none.
  async rows(page) {
    await page.goto(base + "/?sort=battery");
    await live(page);
    await page.mouse.move(5, 5);
    await until(page, () => [...document.querySelectorAll("#fleet-table tbody tr")].map((row) => row.dataset.id).join() === "V1,V2,V3,V4");
    // The table is sorted, and the answer on its way, when the pointer comes.
    await page.evaluate(() => document.querySelector("#fleet-table").addEventListener("pointerenter", () => {
      window.before = [...document.querySelectorAll("#fleet-table tbody tr")].map((row) => row.dataset.id).join();
    }, { once: true, capture: true }));
    await say("away", "sorted");
    await page.hover(mode("V2"));
    await page.waitForSelector(row("V5"));
    await answered(page);
    const before = await page.evaluate(() => window.before);
    const now = (await page.evaluate(order)).split(",");
    equal("under the pointer", now.filter((id) => before.split(",").includes(id)).join(), before);
    await say("held", "changed");
    await shows(page, mode("V2"), "Return RTL");
    equal("still", await page.evaluate(order), now.join());
    await contains(page, ".fleet-order", "Sort now");

    // A selection, results, alarms, and somebody in charge.
    const where = await places(page);
    await page.click(`${row("V1")} td.fleet-check input`);
    await selected(page, "V1");
    await page.waitForSelector("#fleet-actions");
    equal("after a selection", await places(page), where);
    await hold(page, "#fleet-hold");
    await page.waitForSelector("#operation-strip li", { state: "attached" });
    equal("with results", await places(page), where);
    await say("full", "alarmed");
    await page.waitForSelector(`${row("V2")} .fleet-problems .badge:nth-child(2)`);
    await page.waitForSelector(`${row("V2")} .fleet-name .badge`);
    equal("with alarms and somebody in charge", await places(page), where);
    // On a phone the boxes and the dock are in reach.
    await page.setViewportSize({ width: 390, height: 844 });
    await page.click(`${row("V4")} td.fleet-check input`);
    await until(page, () => document.querySelectorAll("#fleet-table tr[aria-selected=true]").length === 2);
    equal("the dock is in sight", await page.locator("#fleet-actions").evaluate((dock) => {
      const { top, bottom } = dock.getBoundingClientRect();
      return dock.contains(document.elementFromPoint(195, (top + bottom) / 2));
    }), true);
    // Sorting is up to the operator.
    await page.click(".fleet-order button");
    await until(page, () => !document.querySelector(".fleet-order"));
    equal("sorted", await page.evaluate(order), "V2,V5,V3,V1,V4");
  },

  // Before a page is live it says so, and nothing on it can be pressed.
  async live(page) {
    await say("signed in", "held");
    for (const [path, button] of [["/", "#fleet-search"], ["/vehicles/V1", "#action-hold"], ["/vehicles/V1", "#action-arm"]]) {
      await page.goto(base + path, { waitUntil: "domcontentloaded" });
      equal(`${path} says so`, /^Connecting…, values of \d\d:\d\d:\d\d UTC$/.test(await page.textContent(".top > .badge")), true);
      equal(`${button} is off`, await page.isDisabled(button), true);
      equal("links work", await page.isEnabled(".nav-link >> nth=0"), true);
      await page.keyboard.press("h");
    }
    await say("off", "released");
    await live(page);
    await page.waitForSelector("#action-hold:enabled");
    equal("it says nothing more", await page.locator(".top > .badge").count(), 0);
    await page.goto(base + "/");
    await live(page);

    // Keys that do nothing say why.
    await page.click(mode("V1"));
    await selected(page, "V1");
    await page.focus("#fleet-table thead input");
    await page.keyboard.press("h");
    await shows(page, "#hint", "H does nothing while “Select all that are shown” has the focus. Move the focus away, then hold H.");
    await page.fill("#fleet-search", "V2");
    await contains(page, ".fleet-hidden", "1 selected vehicle is hidden by the filter: V1");
    await page.evaluate(() => document.activeElement.blur());
    await page.keyboard.press("l");
    await shows(page, "#hint", "Hidden vehicles are selected. Clear the filter or the selection first.");
    // The button does the same as its key and shows the reason.
    await page.evaluate(() => { document.getElementById("hint").hidden = true; });
    await page.hover("#fleet-hold");
    await page.mouse.down();
    await shows(page, "#hint", "Hidden vehicles are selected. Clear the filter or the selection first.");
    await page.mouse.up();
    for (const button of ["#fleet-land", "#fleet-hold"]) equal("no press began", (await presses(page, button)).ended, 0);
    await page.fill("#fleet-search", "");
    await selected(page, "V1");

    // The hand's own times count, however busy the page is.
    const late = (early) => page.evaluate((early) => {
      const button = document.querySelector("#fleet-land");
      button.focus();
      const up = () => new KeyboardEvent("keyup", { key: " ", bubbles: true });
      button.dispatchEvent(new KeyboardEvent("keydown", { key: " ", bubbles: true }));
      const event = up();
      const end = performance.now() + 1000;
      while (performance.now() < end);
      button.dispatchEvent(early ? event : up());
    }, early);
    await steady(page);
    await late(true);
    equal("let go early", JSON.stringify(await presses(page, "#fleet-land")), '{"held":0,"ended":1,"on":false}');
    equal("says what to do", await page.getAttribute("#fleet-land", "data-slip"), "Keep pressing");
    await steady(page);
    await late(false);
    equal("held long enough", (await presses(page, "#fleet-land")).held, 1);
    await page.waitForSelector("#operation-strip li", { state: "attached" });

    // A lost gateway's banner covers nothing. What was selected is so again, even if the page has to be loaded.
    await say("selected", "gone");
    await page.waitForSelector("#gateway-lost:not([hidden])");
    equal("what is covered", await page.evaluate(() => {
      const { bottom } = document.querySelector("#gateway-lost").getBoundingClientRect();
      const covered = [...document.querySelectorAll(".top, .nav, .main")].filter((el) => el.getBoundingClientRect().top < bottom);
      return covered.length + Math.max(0, document.documentElement.scrollHeight - innerHeight);
    }), 0);
    await say("lost", "back");
    await page.waitForSelector("#gateway-lost", { state: "hidden" });
    await live(page);
    await selected(page, "V1");
    await page.reload();
    await live(page);
    await selected(page, "V1");
    await page.goto(base + "/");
    await live(page);
    await answered(page);
    await selected(page, "");
  },
};

main(async (browser) => {
  const page = await open(browser);
  await signIn(page, base, "operator");
  await tasks[task](page);
});
