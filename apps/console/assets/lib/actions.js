// What buttons outside of live pages do: `data-action`.
import { help } from "./keyboard.js";
import { toggle } from "./theme.js";

const focus = (...selectors) => selectors.map((one) => document.querySelector(one)).find(Boolean)?.focus();

const all = {
  theme: toggle,
  help,
  palette: () => window.dispatchEvent(new Event("palette")),
  table: () => focus("#main tr[tabindex='0']", "#main .table-box"),
  actions: () => focus("#main .hold:enabled"),
  close: (button) => button.closest("dialog").close(),
};

export function actions() {
  document.addEventListener("click", (event) => {
    const button = event.target.closest("[data-action]");
    if (button) all[button.dataset.action]?.(button);
    if (button?.matches(".skip")) event.preventDefault();
    for (const menu of document.querySelectorAll("details.menu[open]")) {
      if (button || !menu.contains(event.target)) menu.open = false;
    }
  });
  document.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    for (const menu of document.querySelectorAll("details.menu[open]")) {
      menu.open = false;
      menu.querySelector("summary").focus();
    }
  });
}
