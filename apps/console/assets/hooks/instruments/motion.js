// Values between two samples: samples come 5 to 10 times a second, the display shows 60 images a second. It moves from what it shows
// to the newest sample within the time between two samples, and then stands: it never shows what no sample said.
const SHORTEST = 40;
const LONGEST = 400;

// Degrees that come round after a full turn.
const ROUND = new Set(["roll", "heading"]);

export function between(name, from, to, share) {
  if (to === null || to === undefined) return null;
  if (from === null || from === undefined) return to;
  if (!ROUND.has(name)) return from + (to - from) * share;
  const turn = ((((to - from + 180) % 360) + 360) % 360) - 180;
  return from + turn * share;
}

export class Motion {
  constructor() {
    this.from = {};
    this.to = {};
    this.start = null;
    this.interval = 100;
  }

  // A sample that came at `now` (milliseconds).
  push(sample, now) {
    if (this.start !== null) {
      const since = Math.min(LONGEST, Math.max(SHORTEST, now - this.start));
      this.interval += (since - this.interval) / 4;
    }
    this.from = this.at(now);
    this.to = sample;
    this.start = now;
  }

  at(now) {
    const share = this.start === null ? 1 : Math.min(1, (now - this.start) / this.interval);
    return Object.fromEntries(Object.keys(this.to).map((name) => [name, between(name, this.from[name], this.to[name], share)]));
  }

  settled(now) {
    return this.start === null || now - this.start >= this.interval;
  }
}
