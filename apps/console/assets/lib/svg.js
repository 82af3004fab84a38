// Elements of SVG by their name, attributes and content.
const SPACE = "http://www.w3.org/2000/svg";

export function element(name, attributes = {}, ...content) {
  const node = document.createElementNS(SPACE, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  node.append(...content);
  return node;
}

export const line = (x1, y1, x2, y2, className) => element("line", { x1, y1, x2, y2, class: className });
export const text = (x, y, className, content = "") => element("text", { x, y, class: className }, content);

// Writes only what differs: the browser lays out less.
export function put(node, content) {
  if (node.textContent !== content) node.textContent = content;
}
