// The console's one clock (Aerie.Console.Clock): UTC, 24 hours, whatever the browser's zone and language are.
export const ZONE = "UTC";

// The time of day of unix seconds: 14:39:05, or 14:39 when seconds do not matter.
export function time(seconds, short = false) {
  return new Date(seconds * 1000).toISOString().slice(11, short ? 16 : 19);
}
