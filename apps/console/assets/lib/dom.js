// Elements that scripts make.

// `aria-*`, `data-*` and `role` become attributes, the others properties.
export function element(name, properties = {}) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(properties)) {
    if (key === "role" || key.includes("-")) made.setAttribute(key, value);
    else made[key] = value;
  }
  return made;
}

export function button(text, press) {
  const made = element("button", { type: "button", className: "button small", textContent: text });
  made.addEventListener("click", press);
  return made;
}
