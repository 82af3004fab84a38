// Opens the page of an incident as a file, and prints what its script drew.
import { launch, open } from "./chromium.mjs";

const browser = await launch();
const page = await open(browser);
await page.goto(`file://${process.argv[2]}`);

// How wide the first interval of the mode is, and how many marks are within the lane.
const shown = () =>
  page.evaluate(() => ({
    band: document.querySelector(".band span").getBoundingClientRect().width,
    marks: [...document.querySelectorAll(".marks a")].filter((mark) => /^\d/.test(mark.style.left) && Number.parseFloat(mark.style.left) <= 100).length,
  }));

// Pixels of a curve's colour in a plot.
const drawn = await page.evaluate(() =>
  [...document.querySelectorAll("canvas")].map((canvas) => {
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    let n = 0;
    for (let i = 0; i < data.length; i += 4) if (data[i] === 0x14 && data[i + 1] === 0x56 && data[i + 2] === 0x8f) n += 1;
    return n;
  }));
const whole = await shown();

if (process.argv[3]) await page.screenshot({ path: process.argv[3], fullPage: true });
const over = await page.locator(".curve .u-over").first().boundingBox();
await page.mouse.move(over.x + over.width * 0.25, over.y + 20);
await page.mouse.down();
await page.mouse.move(over.x + over.width * 0.5, over.y + 20, { steps: 5 });
await page.mouse.up();
const zoomed = await shown();
await page.locator(".curve .u-over").first().dblclick();
console.log(JSON.stringify({ drawn, whole, zoomed, again: await shown(), complaints: page.complaints }));
await browser.close();
