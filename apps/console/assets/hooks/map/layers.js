// What the layers of all parts of the map share.

// The first is ours; the others have the signs that it lacks.
export const FONT = ["Inter", "Segoe UI", "Roboto", "Noto Sans", "Liberation Sans", "DejaVu Sans", "sans-serif"];

export const label = (c) => ({ "text-color": c.text, "text-halo-color": c.halo, "text-halo-width": 2 });

// A text above the middle of its line.
export const along = { "symbol-placement": "line-center", "text-field": ["get", "text"], "text-font": FONT, "text-size": 12, "text-offset": [0, -0.9], "text-allow-overlap": true };

// Gives layers that are there already their colours anew.
export function repaint(map, layers) {
  for (const { id, paint = {} } of layers) for (const [name, value] of Object.entries(paint)) map.setPaintProperty(id, name, value);
}
