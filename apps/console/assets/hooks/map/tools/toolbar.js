// The map's buttons: ordinary ones, in the order of the Tab key, with names for screen readers and tool tips.
import { element } from "../../../lib/dom.js";
import { element as svg } from "../../../lib/svg.js";

const ICONS = {
  more: "M4 6h16M4 12h16M4 18h16",
  in: "M12 5v14M5 12h14",
  out: "M5 12h14",
  north: "M12 3l5 16-5-4-5 4z",
  fit: "M4 9V4h5M15 4h5v5M20 15v5h-5M9 20H4v-5",
  follow: "M12 2v4M12 18v4M2 12h4M18 12h4M12 8a4 4 0 100 8 4 4 0 000-8z",
  tracks: "M3 19c4 0 3-6 7-6s3-8 11-8",
  rings: "M12 11v2M12 6a6 6 0 100 12 6 6 0 000-12M12 2a10 10 0 100 20 10 10 0 000-20",
  layers: "M12 3l9 5-9 5-9-5zM3 13l9 5 9-5",
  measure: "M3 17L17 3l4 4L7 21zM7 13l2 2M10 10l2 2M13 7l2 2",
};

// `buttons`: [{name, label, toggle?, press}]
export function toolbar(buttons) {
  const bar = element("div", { className: "map-tools", role: "toolbar", "aria-label": "Map" });
  const made = {};
  // On a phone they would cover a quarter of the map.
  const more = { name: "more", label: "Map buttons", press: () => more.button.setAttribute("aria-expanded", String(bar.classList.toggle("open"))) };
  for (const { name, label, toggle, press } of [more, ...buttons]) {
    const button = element("button", { type: "button", className: "map-tool", title: label, "aria-label": label, "data-tool": name });
    if (toggle) button.setAttribute("aria-pressed", "false");
    button.append(svg("svg", { viewBox: "0 0 24 24", "aria-hidden": "true" }, svg("path", { d: ICONS[name] })));
    button.addEventListener("click", press);
    bar.append(button);
    made[name] = button;
  }
  more.button = made.more;
  more.button.setAttribute("aria-expanded", "false");
  return { bar, press: (name, pressed) => made[name]?.setAttribute("aria-pressed", String(pressed)) };
}
