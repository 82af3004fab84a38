// Says for a moment why a key or a button did nothing.
const SHOWN_MS = 5000;
let timer;

export function hint(text) {
  const el = document.getElementById("hint");
  clearTimeout(timer);
  el.textContent = text;
  el.hidden = false;
  timer = setTimeout(() => { el.hidden = true; }, SHOWN_MS);
}
