// The real client against the running server, one flow after another. Argument: the server's address.
import WebSocket from "ws";
import { equal, open, until } from "./browser.mjs";

const base = process.argv[2];

// Fetches a page as a browser does and opens it. `change` may alter its HTML, `url` what the address bar says.
async function visit(path, { change = (html) => html, url = base + path, params = {} } = {}) {
  const answer = await fetch(base + path);
  equal(`GET ${path}`, answer.status, 200);
  const cookie = answer.headers.getSetCookie().map((line) => line.split(";")[0]).join("; ");
  const html = change(await answer.text());
  const token = html.match(/name="csrf-token" content="([^"]+)"/)[1];
  class Transport extends WebSocket {
    constructor(address, protocols) { super(address, protocols, { headers: { cookie, origin: base } }); }
  }
  const heard = [];
  const Echo = {
    mounted() {
      this.handleEvent("told", (payload) => heard.push(["told", payload]));
      this.handleEvent("mounted", (payload) => heard.push(["mounted", payload]));
      page_.hook = this;
    },
  };
  const page_ = await open(html, {
    url, transport: Transport, params: { _csrf_token: token, ...params }, hooks: { Echo },
    // A view that crashed is joined anew at once, and a page that gave up is loaded at once.
    options: { rejoinAfterMs: () => 10, reloadJitterMin: 1, reloadJitterMax: 2 },
  });
  page_.heard = heard;
  page_.main = () => page_.find("[data-phx-main]");
  page_.connected = () => until("connected", () => page_.main().classList.contains("phx-connected"));
  page_.click = (selector) =>
    page_.find(selector).dispatchEvent(new page_.window.MouseEvent("click", { bubbles: true, cancelable: true }));
  page_.shows = (selector, text) => until(`${selector} shows ${text}, not ${page_.text(selector)}`, () => page_.text(selector) === text);
  page_.type = (selector, text) => {
    const input = page_.find(selector);
    input.focus();
    input.value = text;
    input.dispatchEvent(new page_.window.Event("input", { bubbles: true }));
  };
  return page_;
}

const flows = {
  async "a join, events for hooks, a command without an element"() {
    const page = await visit("/");
    await page.connected();
    await until("the mount's event", () => page.heard.length > 0);
    equal("event", JSON.stringify(page.heard[0]), '["mounted",{"connected":true}]');
    await page.shows("#seen", "seen m");
    page.hook.pushEvent("echo", { a: [1] });
    await until("the event", () => page.heard.some(([name, payload]) => name === "told" && payload.a[0] === 1));
    return page;
  },

  async "clicks: values, commands, the title, rows that move"() {
    const page = await visit("/");
    await page.connected();
    const row = page.find("#row-1");
    page.click("#up");
    await page.shows("#n", "1");
    await until("title", () => page.document.title === "1");
    equal("rows", page.text("#rows"), "321");
    equal("a row that moved is the same element", page.find("#row-1"), row);
    page.click("#two");
    await page.shows("#n", "3");
    return page;
  },

  async "keys"() {
    const page = await visit("/");
    await page.connected();
    const key = (key) => page.find("#keys").dispatchEvent(new page.window.KeyboardEvent("keydown", { key, bubbles: true }));
    key("b");
    key("a");
    await page.shows("#last", "key a");
    return page;
  },

  async "a form: its target, a submit"() {
    const page = await visit("/");
    await page.connected();
    page.type("#name", "Ann & Bo");
    await page.shows("#last", 'change ["user", "name"] Ann & Bo');
    page.find("#user").dispatchEvent(new page.window.Event("submit", { bubbles: true, cancelable: true }));
    await page.shows("#last", "save Ann & Bo");
    return page;
  },

  async "patches: a link, an event, back"() {
    const page = await visit("/");
    await page.connected();
    page.click("#link");
    await page.shows("#q", "linked");
    equal("address", page.window.location.search, "?q=linked");
    page.click("#patch");
    await page.shows("#q", "pushed");
    await until("address", () => page.window.location.search === "?q=pushed");
    page.window.history.back();
    await page.shows("#q", "linked");
    return page;
  },

  async "navigation by links loads no page"() {
    const page = await visit("/");
    await page.connected();
    page.click("#other");
    await page.shows("#id", "1");
    await page.connected();
    await until("title", () => page.document.title === "other 1");
    page.click("#home");
    await page.shows("#n", "0");
    await page.connected();
    await page.shows("#seen", "seen m");
    equal("no page was loaded", page.loads.length, 0);
    return page;
  },

  async "a redirect loads a page, with its flash"() {
    const page = await visit("/");
    await page.connected();
    page.click("#go");
    await until("loaded", () => page.loads[0] === "/other/7");
    const [flash] = page.document.cookie.split("; ").filter((cookie) => cookie.startsWith("__phoenix_flash__="));
    equal("flash", (await (await fetch(base + "/other/7", { headers: { cookie: flash } })).text()).includes("hello"), true);
    return page;
  },

  async "a crash: the page says so, joins again, and recovers its form"() {
    const page = await visit("/");
    await page.connected();
    page.click("#up");
    await page.shows("#n", "1");
    page.type("#name", "kept");
    await page.shows("#last", 'change ["user", "name"] kept');
    page.click("#crash");
    await until("error state", () => page.main().classList.contains("phx-server-error"));
    await page.connected();
    await page.shows("#n", "0");
    await page.shows("#last", 'change ["user", "name"] kept');
    equal("the form is as it was", page.find("#name").value, "kept");
    equal("no page was loaded", page.loads.length, 0);
    return page;
  },

  async "a lost connection: the page says so, connects and joins again"() {
    const page = await visit("/");
    await page.connected();
    page.click("#up");
    await page.shows("#n", "1");
    page.click("#cut");
    await until("error state", () => page.main().classList.contains("phx-client-error"));
    await page.connected();
    await page.shows("#n", "0");
    page.click("#up");
    await page.shows("#n", "1");
    equal("no page was loaded", page.loads.length, 0);
    return page;
  },

  async "a token that is not ours loads the page"() {
    const page = await visit("/", { change: (html) => html.replace(/data-phx-session="[^"]+"/, 'data-phx-session="x.y"') });
    await until("loaded", () => page.loads[0] === "/");
    return page;
  },

  async "the URL of another view loads the page"() {
    const page = await visit("/", { url: base + "/other/3" });
    await until("loaded", () => page.loads[0] === "/other/3");
    return page;
  },

  async "a join that is redirected loads that page"() {
    const page = await visit("/guarded");
    await until("loaded", () => page.loads[0] === "/login");
    return page;
  },

  async "a join that is refused with a status loads the page, which knows it from a cookie"() {
    const page = await visit("/late/missing");
    await until("loaded", () => page.loads[0] === "/late/missing");
    const [status] = page.document.cookie.split("; ").filter((cookie) => cookie.startsWith("__phoenix_reload_status__="));
    equal("status", (await fetch(base + "/late/missing", { headers: { cookie: status } })).status, 404);
    return page;
  },

  async "a join that crashes shows the error state"() {
    const page = await visit("/late/crash");
    await until("error state", () => page.main().classList.contains("phx-server-error"));
    return page;
  },
};

let failed = 0;
for (const [name, flow] of Object.entries(flows)) {
  try {
    const page = await flow();
    if (page.errors.length > 0) throw new Error(page.errors.join("\n"));
    page.close();
    console.log(`ok: ${name}`);
  } catch (error) {
    failed++;
    console.log(`FAILED: ${name}\n  ${error.stack}`);
  }
}
console.log(`${Object.keys(flows).length} flows, ${failed} failed`);
process.exit(failed === 0 ? 0 : 1);
