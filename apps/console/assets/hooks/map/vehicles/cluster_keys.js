// Clusters for the keyboard and for screen readers: a button over each that is in view. The mouse has the map
// below them.
import { element } from "../../../lib/dom.js";

const WORDS = { stale: "stale", lost: "lost", failsafe: "in failsafe" };
const MOST = 40;

export class ClusterKeys {
  // `open(members)` is told what was pressed.
  constructor(map, open) {
    Object.assign(this, { map, open, buttons: new Map() });
    this.list = element("div", { role: "group", "aria-label": "Clusters of vehicles" });
    map.getCanvasContainer().parentElement.after(this.list);
    map.on("move", () => this.buttons.size && this.place());
    map.on("remove", () => this.list.remove());
  }

  // A cluster is its first vehicle, so that its button, and the focus, stay while others come and go.
  show(clusters) {
    const shown = new Set(clusters.map(({ members: [first] }) => first.id));
    for (const [id, { button }] of this.buttons) if (!shown.has(id)) this.drop(id, button);
    for (const { position, members } of clusters.slice(0, MOST)) {
      const one = this.buttons.get(members[0].id) ?? this.add(members[0].id);
      Object.assign(one, { position, members });
      const name = named(members);
      if (one.button.getAttribute("aria-label") !== name) one.button.setAttribute("aria-label", name);
    }
    this.place();
  }

  add(id) {
    const button = element("button", { type: "button", className: "map-cluster" });
    const one = { button };
    button.addEventListener("click", () => this.open(one.members));
    this.buttons.set(id, one);
    this.list.append(button);
    return one;
  }

  // Whoever was on it goes on from the map.
  drop(id, button) {
    if (button === document.activeElement) this.map.getCanvas().focus();
    button.remove();
    this.buttons.delete(id);
  }

  // One that is out of view must not get the focus: the browser would scroll to it.
  place() {
    const { clientWidth, clientHeight } = this.map.getCanvas();
    for (const { button, position } of this.buttons.values()) {
      const { x, y } = this.map.project(position);
      button.hidden = x < 0 || y < 0 || x > clientWidth || y > clientHeight;
      button.style.translate = `${x}px ${y}px`;
    }
  }
}

// How many, and whether somebody among them is in trouble.
export function named(members) {
  const trouble = Object.entries(WORDS).flatMap(([state, word]) => {
    const count = members.filter((one) => one.state === state).length;
    return count ? `${count} ${word}` : [];
  });
  return `${members.length} vehicles, ${trouble.join(", ") || "no trouble"}: zoom in`;
}
