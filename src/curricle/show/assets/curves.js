"use strict";
// Learning curves that answer: uPlot draws them, and beside them stand the values of each arm.
document.addEventListener("DOMContentLoaded", () => {
  const at = (id) => document.getElementById(id);
  const place = at("chart"), rows = [...at("arms").children];
  const data = JSON.parse(at("curves-data").textContent);
  const arms = data.arms.map((arm) => ({ ...arm, shown: true }));
  const listed = rows.map((row) => arms.find((arm) => arm.name === row.dataset.arm));
  let panel = "strong", plot = null, named = null, nearest = null; // arms under the pointer: by name, or line

  const token = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const shownArms = () => arms.filter((arm) => arm.shown);
  const steps = () => data.steps.slice(0, arms[0][panel].mean.length);
  const minus = (text) => text.replace("-", "\u2212");
  const grouped = (value) => minus(value.toLocaleString("en-US", { maximumSignificantDigits: 12 }));
  const fixed = { minimumFractionDigits: data.digits, maximumFractionDigits: data.digits };
  const written = (value) => minus((Number(value.toFixed(data.digits)) + 0).toLocaleString("en-US", fixed));
  const words = (arm, k) => {
    const { mean, low, high } = arm[panel];
    if (mean[k] === null) return "trains its sources";
    return written(mean[k]) + (low[k] === null ? "" : ` [${written(low[k])}, ${written(high[k])}]`);
  };

  // With many arms only one has a band: the arm whose line, or name, is nearest the pointer.
  const banded = (arm) => arm.shown && !at("chart-seeds").checked
    && (shownArms().length <= data.most_bands || arm.name === nearest);
  const setNearest = (name) => {
    nearest = name;
    rows.forEach((row, n) => row.classList.toggle("nearest", listed[n].name === nearest));
    plot.redraw(false);
  };

  // The values at the pointer, or at the end.
  const tell = () => {
    const { idx, top } = plot.cursor, k = idx ?? steps().length - 1, count = `${grouped(steps()[k])} steps`;
    const apart = (arm) => Math.abs(plot.valToPos(arm[panel].mean[k], "y") - top);
    const begun = shownArms().filter((arm) => idx != null && arm[panel].mean[k] !== null);
    const name = named ?? (begun.length ? begun.reduce((a, b) => (apart(b) <= apart(a) ? b : a)).name : null);
    if (name !== nearest) setNearest(name);
    at("chart-steps").textContent = idx == null ? `At the end, ${count}` : count;
    rows.forEach((row, n) => { row.querySelector(".value").textContent = words(listed[n], k); });
    const values = shownArms().map((arm) => `${arm.name} ${words(arm, k)}`);
    place.setAttribute("aria-valuetext", `${count}: ${values.join("; ")}`);
    const range = { valuemin: 0, valuemax: steps().at(-1), valuenow: steps()[k] };
    for (const [key, value] of Object.entries(range)) place.setAttribute(`aria-${key}`, value);
  };

  // Below the lines: the threshold, the time in which sources are trained, and single seeds.
  const drawBelow = (u) => {
    const { ctx, bbox } = u, pxRatio = devicePixelRatio, seeds = at("chart-seeds").checked;
    const x = (value) => u.valToPos(value, "x", true), y = (value) => u.valToPos(value, "y", true);
    const line = (points, colour, width, dashes = []) => {
      ctx.beginPath();
      points.filter(([, value]) => value !== null).forEach(([step, value]) => ctx.lineTo(x(step), y(value)));
      Object.assign(ctx, { strokeStyle: colour, lineWidth: width * pxRatio });
      ctx.setLineDash(dashes.map((dash) => dash * pxRatio));
      ctx.stroke();
    };
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    if (data.threshold !== null) line([[steps()[0], data.threshold], [steps().at(-1), data.threshold]], "#777", 1);
    Object.assign(ctx, { fillStyle: token("--soft"), font: `${12 * pxRatio}px system-ui, sans-serif`, textAlign: "right" });
    const corner = bbox.left + bbox.width - 4 * pxRatio;
    if (data.threshold !== null) ctx.fillText(`threshold ${data.threshold_words}`, corner, y(data.threshold) - 5 * pxRatio);
    for (const arm of shownArms()) {
      const first = arm[panel].mean.findIndex((value) => value !== null), start = steps()[first];
      const before = [[0, data.random], [start, data.random], [start, arm[panel].mean[first]]];
      if (first > 0) line(before, token("--soft"), 1.4, [1.5, 3]);
      const shift = (k) => (panel === "strong" ? arm.source_steps[k] : 0);
      if (seeds) arm.seeds.forEach((row, k) => line(row.map((value, t) => [data.seed_steps[t] + shift(k), value]), `${arm.colour}80`, 0.8));
    }
    ctx.restore();
  };

  // The plot of a panel: for each arm the bounds of its band, and its mean.
  const ends = () => [steps()[0], steps().at(-1)];
  const zoomed = ({ scales: { x: { min, max } } }) => min != null && (min > ends()[0] || max < ends()[1]);
  const size = () => {
    const width = at("chart-place").clientWidth;
    return { width, height: Math.round(Math.max(300, Math.min(470, width * 0.56))) };
  };
  const axis = () => ({
    values: (u, values) => values.map((value) => (value === null ? "" : grouped(value))),
    stroke: token("--line"), grid: { stroke: token("--rule"), width: 1 }, ticks: { stroke: token("--rule"), width: 1 },
    font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif",
  });
  const colour = (u, n) => (n % 3 ? "transparent" : arms[n / 3 - 1].colour);
  const draw = () => {
    plot?.destroy();
    arms.forEach((arm, n) => { if (data.arms[n].colour === "#000000") arm.colour = token("--scratch"); });
    const y = data.symlog ? { distr: 4, asinh: data.symlog } : {};
    const range = (u, low, high) => (zoomed(u) ? uPlot.rangeNum(low, high, 0.06, true) : data.heights);
    const line = { width: 0, points: { show: false } };
    const series = arms.flatMap((arm) => {
      const part = { ...line, show: arm.shown };
      return [part, part, { ...part, width: 2, stroke: arm.colour, dash: arm.dashes }];
    });
    plot = new uPlot({
      ...size(),
      legend: { show: false },
      cursor: { y: false, drag: { x: true, y: true, uni: 20 }, points: { fill: colour, stroke: colour, size: 8 } },
      scales: { x: { time: false }, y: { ...y, range } },
      axes: [
        { ...axis(), label: panel === "strong" ? "target and source steps" : "target steps", space: 80 },
        // A tick at the end of an asinh axis may be no round number.
        { ...axis(), values: (u, all) => axis().values(u, all.map((y) => (data.symlog && y !== Number(y?.toPrecision(6)) ? null : y))), label: `${data.returns}${data.symlog ? ", asinh scale" : ""}`, size: 64 },
      ],
      series: [{}, ...series],
      bands: arms.map((arm, n) => ({ series: [3 * n + 2, 3 * n + 1], fill: () => (banded(arm) ? `${arm.colour}2e` : null) })),
      hooks: { drawAxes: [drawBelow], setCursor: [tell], setScale: [(u) => { at("chart-reset").disabled = !zoomed(u); }] },
    }, [steps(), ...arms.flatMap((arm) => [arm[panel].low, arm[panel].high, arm[panel].mean])], place);
    tell();
  };

  // Zoom by a drag, which is uPlot's, by buttons and by keys, which also move the pointer.
  const show = (low, high) => {
    const [start, end] = ends(), length = Math.min(end - start, Math.max(high - low, 2 * (steps()[1] - steps()[0])));
    const from = Math.max(start, Math.min(end - length, (low + high - length) / 2));
    plot.setScale("x", { min: from, max: from + length });
  };
  const scaled = (factor) => {
    const { min, max } = plot.scales.x, { idx } = plot.cursor, half = ((max - min) * factor) / 2;
    const middle = idx == null ? (min + max) / 2 : steps()[idx];
    show(middle - half, middle + half);
  };
  const reset = () => show(...ends());
  const move = (wanted) => {
    const k = Math.max(0, Math.min(steps().length - 1, wanted)), step = steps()[k], { min, max } = plot.scales.x;
    if (step < min || step > max) show(step - (max - min) / 2, step + (max - min) / 2);
    // after the plot has taken over what is shown, which it does in a microtask
    queueMicrotask(() => plot.setCursor({ left: plot.valToPos(step, "x"), top: plot.over.clientHeight / 2 }));
  };
  place.addEventListener("keydown", (event) => {
    const k = plot.cursor.idx ?? steps().length - 1, far = Math.ceil(steps().length / 10);
    const places = { ArrowLeft: k - 1, ArrowDown: k - 1, ArrowRight: k + 1, ArrowUp: k + 1 };
    Object.assign(places, { Home: 0, End: steps().length - 1, PageUp: k + far, PageDown: k - far });
    const zooms = { "+": 0.5, "=": 0.5, "-": 2 };
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key in places) move(places[event.key]);
    else if (event.key in zooms) scaled(zooms[event.key]);
    else if (event.key === "0" || event.key === "Escape") reset();
    else return;
    event.preventDefault();
  });
  const buttons = { in: () => scaled(0.5), out: () => scaled(2), reset };
  for (const [name, act] of Object.entries(buttons)) at(`chart-${name}`).addEventListener("click", act);

  // The names: each arm is a button, with its value beside it.
  const turn = (n, on) => {
    listed[n].shown = on;
    rows[n].querySelector("button").setAttribute("aria-pressed", on);
    const first = 3 * arms.indexOf(listed[n]) + 1;
    plot.batch(() => [0, 1, 2].forEach((part) => plot.setSeries(first + part, { show: on })));
    setNearest(nearest);
    tell();
  };
  rows.forEach((row, n) => {
    const button = document.createElement("button"), value = document.createElement("span");
    button.type = "button";
    value.className = "value";
    button.append(...row.childNodes);
    button.setAttribute("aria-pressed", true);
    row.append(button, value);
    button.addEventListener("click", () => turn(n, !listed[n].shown));
    row.addEventListener("pointerenter", () => setNearest(named = listed[n].name));
    row.addEventListener("pointerleave", () => setNearest(named = null));
  });
  at("chart-controls")?.addEventListener("change", (event) => {
    listed.forEach((arm, n) => { if (arm.control) turn(n, event.target.checked); });
  });
  at("chart-seeds").addEventListener("change", () => setNearest(nearest));
  for (const name of ["weak", "strong"]) {
    at(`axis-${name}`).addEventListener("change", () => { panel = name; draw(); });
  }
  at("curves").classList.add("answering");
  panel = at("axis-weak").checked ? "weak" : "strong";
  draw();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  new ResizeObserver(() => plot.setSize(size())).observe(at("chart-place"));
});
