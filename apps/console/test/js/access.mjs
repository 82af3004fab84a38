// Signing in and out, roles, keys, the look, and the button that has to be held. Argument: the console's address.
import { contains, equal, hold, holdKey, live, main, open, presses, slip } from "../../../../test/browser/chromium.mjs";
import { signIn } from "./sign_in.mjs";

const base = process.argv[2];
const path = (page) => new URL(page.url()).pathname;

main(async (browser) => {
  // Nobody sees a page; a wrong password is refused; the right one opens it.
  const page = await open(browser);
  await page.goto(base + "/alarms");
  equal("nobody is led to", path(page), "/sign-in");
  await page.fill("#name", "operator");
  await page.fill("#password", "not-the-password");
  await page.click("button[type=submit]");
  await contains(page, ".notice", "The name or the password is wrong.");
  await signIn(page, base, "operator");
  equal("the cookie is not for scripts", await page.evaluate(() => document.cookie.includes("aerie_") && !document.cookie.includes("theme")), false);

  // Keys: g and a letter, the list of all, Escape. The skip link comes first.
  await page.evaluate(() => { window.same = true; });
  await page.keyboard.press("g");
  await page.keyboard.press("a");
  await page.waitForURL(base + "/alarms");
  await live(page);
  await page.keyboard.press("?");
  await page.waitForSelector("#help[open]");
  await page.keyboard.press("Escape");
  await page.waitForSelector("#help:not([open])", { state: "attached" });
  equal("the page was not loaded again", await page.evaluate(() => window.same), true);

  // The look is kept over a load.
  await page.click("#user-menu summary");
  await page.click("[data-action=theme]");
  const theme = await page.getAttribute("html", "data-theme");
  await page.reload();
  equal("the look after a load", await page.getAttribute("html", "data-theme"), theme);
  await live(page);

  // Held too short: nothing. Held: one command, with an id of its own. By a key: another.
  await page.goto(base + "/vehicles/VID-007");
  await live(page);
  await slip(page, "#action-hold");
  await hold(page, "#action-hold");
  // The press goes on if the page moves under the pointer, and ends if the pointer leaves the button.
  await hold(page, "#action-hold", () => page.evaluate(() => {
    const { style } = document.querySelector(".vehicle-foot");
    style.translate = style.translate ? "" : "0 -200px";
  }));
  await page.evaluate(() => { document.querySelector(".vehicle-foot").style.translate = ""; });
  await slip(page, "#action-hold", () => page.mouse.move(700, 300));
  await holdKey(page, "#action-rtl", "r");
  // A busy machine may have made more of it than was meant.
  for (const name of ["hold", "rtl"]) console.log(`${name}: ${(await presses(page, `#action-${name}`)).held}`);

  // Out again, and nothing is left to see.
  await page.click("#user-menu summary");
  await page.click("form[action='/sign-out'] button");
  await page.waitForURL(base + "/sign-in");
  await page.goto(base + "/");
  equal("after signing out", path(page), "/sign-in");

  // A viewer has no buttons for commands.
  const viewer = await open(browser);
  await signIn(viewer, base, "viewer", "/vehicles/VID-007");
  equal("a viewer's buttons", await viewer.locator(".hold").count(), 0);
  equal("complaints", JSON.stringify([...page.complaints, ...viewer.complaints].filter((text) => !/403/.test(text))), "[]");
});
