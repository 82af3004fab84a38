// Applies diffs with the real client and compares the DOM with the HTML that the server would render.
// Lines of the file: {"full": tree, "html": …} begins a page, {"diff": …, "html": …} follows.
import { readFileSync } from "node:fs";
import { open, until } from "./browser.mjs";

class Scripted {
  static OPEN = 1;
  readyState = 0;
  bufferedAmount = 0;
  constructor() {
    Scripted.last = this;
    setTimeout(() => { this.readyState = 1; this.onopen?.(); });
  }
  send(text) {
    const [joinRef, ref, topic, event] = JSON.parse(text);
    if (event === "phx_join") {
      this.joinRef = joinRef;
      this.topic = topic;
      this.push(ref, "phx_reply", { status: "ok", response: { rendered: Scripted.tree, liveview_version: "1.2.12" } });
    } else this.push(ref, "phx_reply", { status: "ok", response: {} });
  }
  push(ref, event, payload) {
    this.onmessage({ data: JSON.stringify([this.joinRef, ref, this.topic, event, payload]) });
  }
  close() { this.readyState = 3; this.onclose?.({ code: 1000, wasClean: true }); }
}

// What the client adds for itself.
const plain = (html) => html.replace(/ data-phx-(id|stream|skip)(="[^"]*")?/g, "");

const lines = readFileSync(process.argv[2], "utf8").trim().split("\n").map((line) => JSON.parse(line));
let page, container, compared = 0, different = 0;
for (const [number, line] of lines.entries()) {
  if (line.full) {
    page?.close();
    Scripted.tree = line.full;
    page = await open(`<div id="phx-t" data-phx-main data-phx-session="s" data-phx-static=""></div>`, {
      url: "http://localhost/", transport: Scripted,
    });
    container = page.find("#phx-t");
    await until("joined", () => container.classList.contains("phx-connected"));
  } else if (Object.keys(line.diff).length > 0) Scripted.last.push(null, "diff", line.diff);

  const expected = page.document.createElement("template");
  expected.innerHTML = line.html;
  compared++;
  if (plain(container.innerHTML) !== expected.innerHTML && different++ < 5)
    console.log(`line ${number + 1}: ${JSON.stringify(line)}\n  the page has ${plain(container.innerHTML)}`);
}
if (page.errors.length > 0) { console.log(page.errors); different++; }
console.log(`${compared} compared, ${different} different`);
process.exit(different === 0 ? 0 : 1);
