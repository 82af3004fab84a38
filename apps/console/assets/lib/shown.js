// What a button or a form is for, as the operator sees it: its `phx-value-*`, the JSON of its `data-value`, and what the form around it says.
// A press sends this, and never what the server has by the time it arrives.
export function shown(el) {
  const value = JSON.parse(el.dataset.value ?? "{}");
  for (const { name, value: text } of el.attributes) {
    if (name.startsWith("phx-value-")) value[name.slice("phx-value-".length)] = text;
  }
  const form = el.closest("form");
  if (form) value.fields = Object.fromEntries(new FormData(form));
  return value;
}
