// A page in jsdom with the unmodified client of npm, which runs inside the page as in a browser.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { JSDOM, VirtualConsole } from "jsdom";

const modules = join(dirname(createRequire(import.meta.url).resolve("jsdom/package.json")), "..");
const client = ["phoenix/priv/static/phoenix.min.js", "phoenix_live_view/priv/static/phoenix_live_view.min.js"]
  .map((file) => readFileSync(join(modules, file), "utf8"));

// Opens HTML as a page. `loads` are the addresses of the pages that the client would load, which jsdom cannot do.
export async function open(html, { url, transport, params = {}, hooks = {}, options = {} }) {
  const virtualConsole = new VirtualConsole();
  const page = { loads: [], errors: [] };
  virtualConsole.on("jsdomError", (error) => {
    if (!/navigation/.test(error.message)) page.errors.push(error.message);
  });
  const dom = new JSDOM(html, { url, pretendToBeVisual: true, runScripts: "outside-only", virtualConsole });
  const window = dom.window;
  window.CSS ??= { escape: (text) => text.replace(/([^\w-])/g, "\\$1") };
  window.scroll = window.scrollTo = () => {};
  window.WebSocket = transport;
  // Pages of localhost are otherwise logged at length.
  window.sessionStorage.setItem("phx:live-socket:debug", "false");
  for (const code of client) window.eval(code);

  const socket = new window.LiveView.LiveSocket("/live", window.Phoenix.Socket, { params, hooks, transport, ...options });
  const redirect = socket.redirect.bind(socket);
  socket.redirect = (to, ...others) => {
    page.loads.push(new URL(to, url).pathname);
    redirect(to, ...others);
  };
  Object.assign(page, { dom, window, document: window.document, socket });
  page.find = (selector) => window.document.querySelector(selector);
  page.text = (selector) => page.find(selector)?.textContent;
  page.close = () => { socket.disconnect(); window.close(); };
  socket.connect();
  return page;
}

// Waits until a condition holds. The limit only guards against hanging.
export async function until(what, holds, limit = 180_000) {
  const end = Date.now() + limit;
  for (;;) {
    const value = holds();
    if (value) return value;
    if (Date.now() > end) throw new Error(`not so in time: ${what}`);
    await new Promise((resolve) => setTimeout(resolve, 5));
  }
}

export function equal(what, found, expected) {
  if (found !== expected) throw new Error(`${what}\n  expected ${JSON.stringify(expected)}\n  found    ${JSON.stringify(found)}`);
}
