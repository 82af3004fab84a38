// Draws the recorded values with uPlot. All plots have one scale of time: dragging in one of them zooms all, a double click
// shows everything again.
(() => {
  const HEIGHT = 120, LEFT = 58, RIGHT = 12, METRES = 111320;
  const data = JSON.parse(document.getElementById("data").textContent);
  const colour = (name) => getComputedStyle(document.body).getPropertyValue(`--${name}`);
  const clock = (at) => new Date(at * 1000).toISOString().slice(11, 19);
  const number = (value) => (value == null ? "–" : Number.parseFloat(value.toPrecision(5)).toString());
  const marks = data.drawings.find(({ kind }) => kind === "marks")?.points ?? [];
  const plots = [], lanes = [];
  let zoom = null;

  const range = () => zoom ?? [data.from, data.to];

  function show() {
    const [from, to] = range();
    plots.forEach((plot) => plot.setScale("x", { min: from, max: to }));
    const place = (at) => (100 * (at - from)) / (to - from);
    for (const { node, begin, end } of lanes) {
      node.style.left = `${place(begin)}%`;
      if (end !== undefined) node.style.width = `${Math.max(place(end) - place(begin), 0.1)}%`;
    }
  }

  function select(plot) {
    const { left, width } = plot.select;
    if (width < 5) return;
    zoom = [plot.posToVal(left, "x"), plot.posToVal(left + width, "x")];
    plots.forEach((one) => one.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false));
    show();
  }

  function all() {
    zoom = null;
    show();
  }

  // What happened: each mark is a link to its row of the table.
  function lane(place, points) {
    for (const [n, at, kind, text] of points) {
      const node = Object.assign(document.createElement("a"), { href: `#r${n}`, className: kind, title: text });
      place.append(node);
      lanes.push({ node, begin: at });
    }
  }

  // Intervals with a value each, such as the mode.
  function band(place, points) {
    for (const [begin, end, text, className] of points) {
      const title = `${clock(begin)} ${text}`;
      const node = Object.assign(document.createElement("span"), { className, title, textContent: text });
      place.append(node);
      lanes.push({ node, begin, end });
    }
  }

  // A curve is interrupted where nothing was known.
  function columns(points) {
    const times = [], values = [];
    for (const [at, value] of points) {
      if (at - times.at(-1) > data.gap) {
        times.push((at + times.at(-1)) / 2);
        values.push(null);
      }
      times.push(at);
      values.push(value);
    }
    return [times, values];
  }

  function line(plot, x, kind) {
    const { ctx, bbox } = plot;
    ctx.strokeStyle = colour(kind);
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
  }

  function markLines(plot) {
    const [from, to] = range();
    for (const [, at, kind] of marks)
      if (kind !== "note" && at >= from && at <= to) line(plot, plot.valToPos(at, "x", true), kind);
  }

  function curve(place, points, title) {
    const grid = { stroke: colour("grid"), width: 1 }, stroke = colour("quiet");
    const plot = new uPlot({
      width: place.clientWidth, height: HEIGHT, padding: [6, RIGHT, 0, 0],
      tzDate: (at) => uPlot.tzDate(new Date(at * 1000), "Etc/UTC"),
      scales: { x: { time: true, range } },
      series: [{ label: "UTC", value: (_plot, at) => (at == null ? "–" : clock(at)) },
        { label: title, stroke: colour("command"), width: 1.4, value: (_plot, value) => number(value) }],
      axes: [{ stroke, grid, ticks: grid, size: 34, values: (_plot, times) => times.map(clock) },
        { stroke, grid, ticks: grid, size: LEFT, values: (_plot, values) => values.map(number) }],
      cursor: { sync: { key: "time" }, drag: { x: true, y: false, setScale: false } },
      hooks: { drawClear: [markLines], setSelect: [select] },
    }, columns(points), place);
    plot.over.addEventListener("dblclick", all);
    plots.push(plot);
  }

  // Metres around the first place, north up, without a map. A track across the date line stays whole.
  function track(place, points) {
    const [latitude, longitude] = points[0], east = METRES * Math.cos((latitude * Math.PI) / 180);
    const around = (degrees) => degrees - 360 * Math.round(degrees / 360);
    const xs = points.map(([, lon]) => around(lon - longitude) * east);
    const ys = points.map(([lat]) => (lat - latitude) * METRES);
    const ends = (values) => values.reduce(([low, high], v) => [Math.min(low, v), Math.max(high, v)], [0, 0]);
    const half = 0.55 * Math.max(...[xs, ys].map(ends).map(([low, high]) => high - low), 10);
    const middle = ([low, high]) => [(low + high) / 2 - half, (low + high) / 2 + half];
    const grid = { stroke: colour("grid"), width: 1 };
    const axis = (label) => ({ label, labelSize: 18, stroke: colour("quiet"), grid, ticks: grid, size: LEFT });

    const draw = (plot) => {
      const { ctx } = plot, at = (i) => [plot.valToPos(xs[i], "x", true), plot.valToPos(ys[i], "y", true)];
      ctx.strokeStyle = colour("command");
      ctx.beginPath();
      xs.forEach((_x, i) => ctx.lineTo(...at(i)));
      ctx.stroke();
      for (const [i, name] of [[0, "begin"], [xs.length - 1, "end"]]) {
        ctx.fillStyle = colour(name);
        ctx.beginPath();
        ctx.arc(...at(i), 4 * devicePixelRatio, 0, 2 * Math.PI);
        ctx.fill();
      }
    };

    new uPlot({
      mode: 2, width: 440, height: 440, legend: { show: false }, cursor: { drag: { x: false, y: false } },
      scales: { x: { time: false, range: () => middle(ends(xs)) }, y: { range: () => middle(ends(ys)) } },
      axes: [axis("metres east"), axis("metres north")],
      series: [{}, { facets: [{ scale: "x", auto: true }, { scale: "y", auto: true }], paths: () => null }],
      hooks: { draw: [draw] },
    }, [null, [xs, ys]], place);
  }

  const kinds = { marks: lane, band, curve, track };
  data.drawings.forEach(({ kind, points, title }, n) => {
    if (points.length > 0) kinds[kind](document.getElementById(`d${n}`), points, title);
  });
  show();
  window.addEventListener("resize", () => {
    for (const plot of plots) plot.setSize({ width: plot.root.parentNode.clientWidth, height: HEIGHT });
  });
})();
