// Rows of samples in columns, as uPlot wants them, with a bound: the oldest go.
export class Samples {
  constructor(keys, limit) {
    this.limit = limit;
    this.columns = new Map(keys.map((key) => [key, []]));
    this.times = [];
  }

  // Other fields are chosen: what is known of those that stay is kept, the others have had no values so far.
  choose(keys) {
    const before = this.columns;
    this.columns = new Map(keys.map((key) => [key, before.get(key) ?? this.times.map(() => null)]));
  }

  // `values` by key at a time in seconds; a field without one has a gap.
  push(time, values) {
    if (this.times.length > 0 && time <= this.times.at(-1)) return;
    this.times.push(time);
    for (const [key, column] of this.columns) column.push(values[key] ?? null);
    this.bound();
  }

  // Rows of before: those that are older than the first sample come in front, and a field that was chosen later gets its values where it has none.
  before(rows) {
    const places = new Map(this.times.map((time, i) => [time, i]));
    const first = this.times[0] ?? Infinity;
    const older = rows.filter(([time]) => time < first && !places.has(time));
    for (const [time, values] of rows) {
      const i = places.get(time);
      if (i === undefined) continue;
      for (const [key, value] of Object.entries(values)) if (this.columns.has(key)) this.columns.get(key)[i] ??= value;
    }
    this.times.unshift(...older.map(([time]) => time));
    for (const [key, column] of this.columns) column.unshift(...older.map(([, values]) => values[key] ?? null));
    this.bound();
  }

  bound() {
    const over = this.times.length - this.limit;
    if (over <= 0) return;
    this.times.splice(0, over);
    for (const column of this.columns.values()) column.splice(0, over);
  }

  data(keys) {
    return [this.times, ...keys.map((key) => this.columns.get(key))];
  }

  csv(keys, { from = -Infinity, to = Infinity } = {}) {
    const quote = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
    const lines = [["time", ...keys].map(quote).join(",")];
    this.times.forEach((time, i) => {
      if (time < from || time > to) return;
      const values = keys.map((key) => this.columns.get(key)[i] ?? "");
      lines.push([new Date(time * 1000).toISOString(), ...values].join(","));
    });
    return `${lines.join("\n")}\n`;
  }
}
