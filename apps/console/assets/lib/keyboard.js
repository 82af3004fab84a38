// Keys that work everywhere but where somebody types: g and a letter go to a page, / to its search, ? lists all. Holding a key for a button is the button's
// own affair (hooks/hold_button.js).
const WAIT_MS = 1500;
let going;

export const typing = (target) => target.closest?.("input, select, textarea, [contenteditable]");

export function keyboard() {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.repeat || typing(event.target)) return;
    if (document.querySelector("dialog[open]")) return;
    const key = event.key.toLowerCase();
    if (going) {
      const link = document.querySelector(`.nav .nav-link[data-key="${CSS.escape(key)}"]`);
      stop();
      // A letter that is a page's after g is not at the same time the shortcut of a button.
      if (link) { event.preventDefault(); event.stopImmediatePropagation(); link.click(); }
    } else if (key === "g") {
      going = setTimeout(stop, WAIT_MS);
    } else if (event.key === "/") {
      const search = document.querySelector("#main input[type=search]");
      if (search) { event.preventDefault(); search.focus(); search.select(); }
    } else if (event.key === "?") {
      event.preventDefault();
      help();
    }
  }, { capture: true });
}

function stop() {
  clearTimeout(going);
  going = undefined;
}

export function help() {
  const dialog = document.getElementById("help");
  if (!dialog?.open) dialog?.showModal();
}
