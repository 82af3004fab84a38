// The menu of a place: by the other mouse button, by a finger that rests, or by the menu key, which takes the centre of the view.
import { element } from "../../../lib/dom.js";

const REST_MS = 500;
const TREMBLE_PX = 10;

export class PlaceMenu {
  // `choose(act)`: what was chosen for `this.place`. `closed()`: the place is no longer asked about.
  constructor(el, choose, closed) {
    this.el = el;
    this.choose = choose;
    this.closed = closed;
    this.outside = (event) => this.menu?.contains(event.target) || this.close();
  }

  get isOpen() {
    return this.menu !== undefined;
  }

  // `items`: [{act, label, refusal}]; one with a refusal says why, and does nothing.
  open({ title, items, note }, place, { x, y }) {
    this.close();
    this.place = place;
    this.from = document.activeElement;
    const menu = (this.menu = element("div", { className: "map-menu" }));
    const list = element("div", { className: "map-menu-items", role: "menu", "aria-label": note ? `${title}. ${note}` : title });
    list.append(...items.map((item) => this.item(item)));
    menu.append(element("p", { className: "map-menu-title", textContent: title }), list);
    if (note) menu.append(element("p", { className: "map-menu-note", textContent: note }));
    menu.addEventListener("keydown", (event) => this.key(event));
    menu.addEventListener("contextmenu", (event) => event.preventDefault());
    this.el.append(menu);
    menu.style.left = `${Math.max(4, Math.min(x, this.el.clientWidth - menu.offsetWidth - 4))}px`;
    menu.style.top = `${Math.max(4, Math.min(y, this.el.clientHeight - menu.offsetHeight - 4))}px`;
    document.addEventListener("pointerdown", this.outside, true);
    menu.querySelector("button").focus();
  }

  item({ act, label, refusal }) {
    const button = element("button", { type: "button", className: "map-menu-item", textContent: label, tabIndex: -1, role: "menuitem", "data-act": act });
    if (refusal) {
      button.setAttribute("aria-disabled", "true");
      button.append(element("small", { textContent: refusal }));
    }
    button.addEventListener("click", () => {
      if (refusal) return;
      this.close();
      this.choose(act);
    });
    return button;
  }

  key(event) {
    const items = [...this.menu.querySelectorAll("button")];
    const at = items.indexOf(document.activeElement);
    const next = { ArrowDown: (at + 1) % items.length, ArrowUp: (at - 1 + items.length) % items.length, Home: 0, End: items.length - 1 }[event.key];
    if (next !== undefined) items[next].focus();
    else if (event.key === "Escape" || event.key === "Tab") this.close();
    else return;
    event.stopPropagation();
    if (event.key !== "Tab") event.preventDefault();
  }

  close() {
    if (!this.menu) return;
    document.removeEventListener("pointerdown", this.outside, true);
    const inside = this.menu.contains(document.activeElement);
    this.menu.remove();
    this.menu = undefined;
    if (inside) this.from?.focus();
    this.closed();
  }
}

// Calls `rested` with the event of a finger that stays where it is. Not each browser makes a right click of it.
export function whenResting(map, rested) {
  let timer;
  let from;
  const end = () => clearTimeout(timer);
  map.on("touchstart", (event) => {
    end();
    from = event.point;
    if (event.points.length === 1) timer = setTimeout(() => rested(event), REST_MS);
  });
  map.on("touchmove", ({ point }) => Math.hypot(point.x - from.x, point.y - from.y) > TREMBLE_PX && end());
  for (const event of ["touchend", "touchcancel"]) map.on(event, end);
}
