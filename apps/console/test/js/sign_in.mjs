// What every test in a browser begins with.
import { live } from "../../../../test/browser/chromium.mjs";

// Signs in as one of Aerie.ConsoleCase's users, and waits for the page to live.
export async function signIn(page, base, role, path = "/") {
  await page.goto(base + "/sign-in");
  await page.fill("#name", role);
  await page.fill("#password", `password-of-${role}`);
  await page.click("button[type=submit]");
  await page.waitForURL(base + "/");
  if (path !== "/") await page.goto(base + path);
  await live(page);
}
