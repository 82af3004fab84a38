// Dark, light, or what the system asks for. The choice is a cookie, so that the server sends the page as it will look.
const root = document.documentElement;

export function dark() {
  return root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

export function toggle() {
  root.dataset.theme = dark() ? "light" : "dark";
  document.cookie = `aerie_theme=${root.dataset.theme}; path=/; max-age=31536000; samesite=lax`;
  window.dispatchEvent(new CustomEvent("theme"));
}

matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => window.dispatchEvent(new CustomEvent("theme")));

// The present value of a token of tokens.css (`--ok`) as rgb(), for maps and charts, which draw by themselves. They draw again on the
// window's event "theme".
export function color(token) {
  const probe = document.createElement("span");
  document.body.append(probe);
  probe.className = "visually-hidden";
  probe.style.color = `var(${token})`;
  const found = getComputedStyle(probe).color;
  probe.remove();
  return found;
}
