// For scripts between whose steps the test acts: what the script has done is a line of its output, and the test answers with one.
import { createInterface } from "node:readline";
import { equal, press, presses, until } from "../../../../test/browser/chromium.mjs";

const lines = createInterface({ input: process.stdin })[Symbol.asyncIterator]();

export const say = async (word, answer) => { console.log(word); equal("told", (await lines.next()).value, answer); };

// Something changes while a button is held: the press ends, and nothing is sent. `seen` waits until the page shows the change.
export async function underHand(page, button, [word, answer], seen) {
  const hold = await page.evaluate((button) => {
    const { dataset } = document.querySelector(button);
    const { hold } = dataset;
    dataset.hold = "600000";
    return hold;
  }, button);
  await press(page, button);
  await say(word, answer);
  await seen();
  await until(page, (button) => document.querySelector(button).dataset.state !== "holding", button);
  await page.mouse.up();
  equal("nothing was held", (await presses(page, button)).held, 0);
  await page.evaluate(([button, hold]) => { document.querySelector(button).dataset.hold = hold; }, [button, hold]);
}

// What the map shows of the sheet that is open: `1: 20 m`, and a cross before what is bad.
export const previewed = (page, texts) => until(page, (texts) => {
  const shown = document.querySelector("#fleet-map").fleetMap?.overlays.parts.preview ?? [];
  return shown.map(({ properties: { kind, text } }) => text ?? kind).join() === texts;
}, texts);
