// A colour for each tag, the same in every browser: by the tag's name, and the next one if another tag has that already.

export const TAG_COLOURS = 8; // --map-tag-0 … of css/map.css

// Numbers of colours by tag.
export function tagColours(tags) {
  const taken = new Map();
  const used = new Set();
  for (const tag of [...new Set(tags)].sort()) {
    let colour = [...tag].reduce((sum, sign) => (sum * 31 + sign.codePointAt(0)) % 65_521, 7) % TAG_COLOURS;
    while (used.has(colour) && used.size < TAG_COLOURS) colour = (colour + 1) % TAG_COLOURS;
    used.add(colour);
    taken.set(tag, colour);
  }
  return taken;
}

const sheet = globalThis.document && new CSSStyleSheet();

// Everything on the page that stands for a tag (`data-tag`) has its colour.
export function paint(tags) {
  sheet.replaceSync([...tags].map(([tag, colour]) => `[data-tag="${CSS.escape(tag)}"] { --tag: var(--map-tag-${colour}); }`).join("\n"));
  if (!document.adoptedStyleSheets.includes(sheet)) document.adoptedStyleSheets.push(sheet);
}
