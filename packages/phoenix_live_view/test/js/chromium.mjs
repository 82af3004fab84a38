// A few flows in a browser, with its Content-Security-Policy. Argument: the server's address.
import { equal, live, main, open, shows } from "../../../../test/browser/chromium.mjs";

const base = process.argv[2];

main(async (browser) => {
  const page = await open(browser);
  await page.goto(base + "/");
  await live(page);

  // Events, a command that shows an element although the policy forbids inline styles, rows, forms.
  await page.click("#up");
  await shows(page, "#n", "1");
  // The client sets the title after the page.
  await page.waitForFunction(() => document.title === "1");
  await page.click("#two");
  await shows(page, "#n", "3");
  await page.fill("#name", "Ann");
  await shows(page, "#last", 'change ["user", "name"] Ann');
  await page.click("#save");
  await shows(page, "#last", "save Ann");

  // Navigation and history without loading a page.
  await page.evaluate(() => { window.same = true; });
  await page.click("#link");
  await shows(page, "#q", "linked");
  await page.click("#other");
  await shows(page, "#id", "1");
  await page.goBack();
  await shows(page, "#q", "linked");
  await live(page);
  equal("the page was not loaded again", await page.evaluate(() => window.same), true);

  // The view crashes, then the connection; the page recovers from both.
  await page.fill("#name", "kept");
  await shows(page, "#last", 'change ["user", "name"] kept');
  for (const button of ["#crash", "#cut"]) {
    await page.click("#up");
    await page.waitForFunction(() => document.querySelector("#n").textContent !== "0");
    await page.click(button);
    await shows(page, "#n", "0");
    await live(page);
    equal(`the form after ${button}`, await page.inputValue("#name"), "kept");
  }
  equal("the page was not loaded again", await page.evaluate(() => window.same), true);
  equal("complaints of the browser", JSON.stringify(page.complaints.filter((text) => !/WebSocket|favicon|404/.test(text))), "[]");
});
