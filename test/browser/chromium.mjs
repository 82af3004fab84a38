// A Chromium for tests: pages whose complaints are kept, and what tests ask of them. The limits only guard against hanging.
import { chromium } from "playwright-core";

export const PATIENCE_MS = 300_000;
// How often a press is made again that did not end as it was meant.
const TIMES = 30;
// What is drawn without a graphics card costs by the pixel.
export const SMALL = { width: 1024, height: 700 };

// Pages are our own; a container often has no user namespaces for the sandbox.
export async function launch() {
  return chromium.launch({
    executablePath: process.env.AERIE_CHROMIUM,
    args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
  });
}

// A page in a context of its own. `page.complaints` has what it wrote to the console as errors, and exceptions.
export async function open(browser, options = {}) {
  const context = await browser.newContext({ reducedMotion: "reduce", ...options });
  const page = await context.newPage();
  page.setDefaultTimeout(PATIENCE_MS);
  page.complaints = [];
  page.on("console", (message) => { if (message.type() === "error") page.complaints.push(message.text()); });
  page.on("pageerror", (error) => page.complaints.push(error.message));
  return page;
}

export const live = (page) => page.waitForSelector("[data-phx-main].phx-connected");

// Waits until a function holds in the page. Unlike Playwright's default it does not wait for frames, which software WebGL draws slowly.
export const until = (page, holds, value) => page.waitForFunction(holds, value, { polling: 100 });

export const shows = (page, selector, text) =>
  until(page, ([selector, text]) => document.querySelector(selector)?.textContent.trim() === text, [selector, text]);

export const contains = (page, selector, text) =>
  until(page, ([selector, text]) => document.querySelector(selector)?.textContent.includes(text), [selector, text]);

// What a button of Aerie.Console.UI.HoldButton went through: its presses that ended, and the one that is on. Null if there is no such button.
export const presses = (page, selector) =>
  page.evaluate((selector) => {
    const { heldCount, slippedCount, state } = document.querySelector(selector)?.dataset ?? {};
    return document.querySelector(selector) && { held: Number(heldCount ?? 0), ended: Number(heldCount ?? 0) + Number(slippedCount ?? 0), on: state === "holding" };
  }, selector);

// Presses such a button with the mouse. The page may move between the pointer's way there and the press, and on a busy machine the gateway may
// seem lost for a moment: then the press does nothing, and is made again. A brief press ends at once.
export async function press(page, selector, { brief = false } = {}) {
  const button = page.locator(`${selector}:not([disabled])`);
  for (;;) {
    await page.waitForSelector("html:not(.gateway-lost)");
    await button.hover();
    const before = await presses(page, selector);
    await (brief ? Promise.all([page.mouse.down(), page.mouse.up()]) : page.mouse.down());
    const now = await presses(page, selector);
    // Some buttons disappear when they were held.
    if (!now || now.on || now.ended > (before?.ended ?? 0)) return;
    await page.mouse.up();
  }
}

// Presses it until it has sent its event; what ended the press on the way starts it again. `meanwhile` is done after each press.
export async function hold(page, selector, meanwhile = async () => {}) {
  await page.waitForSelector(selector);
  await untilHeld(page, selector, async () => { await press(page, selector); await meanwhile(); }, () => page.mouse.up());
}

// The same by its key.
export async function holdKey(page, selector, key) {
  await page.waitForSelector(selector);
  const down = async () => { await page.waitForSelector("html:not(.gateway-lost)"); await page.keyboard.down(key); };
  await untilHeld(page, selector, down, () => page.keyboard.up(key));
}

async function untilHeld(page, selector, down, up) {
  const before = (await presses(page, selector)).held;
  for (let times = TIMES; times > 0; times -= 1) {
    await down();
    const outcome = await until(page, ([selector, before]) => {
      const { dataset } = document.querySelector(selector) ?? {};
      if (!dataset || Number(dataset.heldCount ?? 0) > before) return "held";
      return dataset.state === "holding" ? false : "let go";
    }, [selector, before]);
    await up();
    if ((await outcome.jsonValue()) === "held") return;
  }
  throw new Error(`${selector} was let go each time`);
}

// Presses it too short: briefly, or until `meanwhile` ends the press. A busy machine may be so slow that it sends its event all the same.
export async function slip(page, selector, meanwhile) {
  for (let times = TIMES; times > 0; times -= 1) {
    const { held } = await presses(page, selector);
    await press(page, selector, { brief: !meanwhile });
    await meanwhile?.();
    await until(page, (selector) => document.querySelector(selector).dataset.state !== "holding", selector);
    await page.mouse.up();
    if ((await presses(page, selector)).held === held) return;
  }
  throw new Error(`${selector} has sent its event each time`);
}

export function equal(what, found, expected) {
  if (found !== expected) throw new Error(`${what}\n  expected ${JSON.stringify(expected)}\n  found    ${JSON.stringify(found)}`);
}

// The text of a page, for the output of a test that fails; and a screenshot in the folder AERIE_SHOTS if that is set.
async function seen(page) {
  const folder = process.env.AERIE_SHOTS;
  if (folder) await page.screenshot({ path: `${folder}/failed-${Date.now()}.png` }).catch(() => {});
  return page.evaluate(() => document.querySelector("#main")?.innerText.slice(0, 2_000)).catch(() => "");
}

// Runs a test's body and ends with its status.
export async function main(body) {
  const browser = await launch();
  let status = 0;
  try {
    await body(browser);
    console.log("ok");
  } catch (error) {
    for (const context of browser.contexts()) {
      for (const page of context.pages()) console.log(page.url(), page.complaints, await seen(page));
    }
    console.log(error.stack);
    status = 1;
  }
  await browser.close();
  process.exit(status);
}
