"use strict";
// Learning curves that answer: values at a checkpoint, zoom, arms and seeds on and off, pictures.
document.addEventListener("DOMContentLoaded", () => {
  const views = { strong: null, weak: null };
  const at = (id) => document.getElementById(id);
  const chart = at("chart"), rows = [...at("arms").children];
  const data = JSON.parse(at("curves-data").textContent);
  const SVG = "http://www.w3.org/2000/svg", GREY = "#444", RULE = "#e4e4e4";

  // Rows of numbers hold their first number, then differences; null stands for no number.
  const summed = (differences, unit = 1) => {
    let sum = 0;
    return differences.map((item) => (item === null ? NaN : (sum += item) / unit));
  };
  const unit = 10 ** data.digits, steps = summed(data.steps), seedSteps = summed(data.seed_steps);
  const returns = (row) => summed(row, unit);
  const band = ({ first, mean, low, high }) => {
    const inside = steps.slice(first, first + mean.length);
    return { first, steps: inside, mean: returns(mean), low: returns(low), high: returns(high) };
  };
  const arms = data.arms.map((arm) => {
    const { weak, strong, seeds } = arm;
    return { ...arm, shown: true, weak: band(weak), strong: band(strong), seeds: seeds.map(returns) };
  });
  const listed = rows.map((row) => arms.find((arm) => arm.name === row.dataset.arm));
  const shownArms = () => arms.filter((arm) => arm.shown);
  const hides = (name) => shownArms().length > data.most_bands && name !== nearest;

  // What is shown: steps, and heights on the axis of returns. No view, of steps and returns, means all.
  // With many arms only one has a band: the arm whose line, or name, is nearest the pointer.
  let panel = "strong", cursor = null, drag = null, scales = null, nearest = null;
  const whole = () => ({ x: data.panels[panel].x, y: data.panels[panel].y.map(heightOf) });
  const current = () => (views[panel] ? { x: views[panel].x, y: views[panel].y.map(heightOf) } : whole());
  const last = () => arms[0][panel].first + arms[0][panel].mean.length - 1;

  // Matplotlib's symlog scale: linear around 0, logarithmic beyond; or linear everywhere.
  const [linear, decades] = data.symlog || [Infinity, 0.9], knee = decades / 0.9;
  const heightOf = (value) => (Math.abs(value) <= linear ? value * knee
    : Math.sign(value) * linear * (knee + Math.log10(Math.abs(value) / linear)));
  const valueAt = (height) => (Math.abs(height) <= linear * knee ? height / knee
    : Math.sign(height) * linear * 10 ** (Math.abs(height) / linear - knee));

  const minus = (text) => text.replace("-", "\u2212");
  const label = (value) => minus(value.toLocaleString("en-US", { maximumSignificantDigits: 12 }));
  const fixed = { minimumFractionDigits: data.digits, maximumFractionDigits: data.digits };
  const written = (value) => minus((Number(value.toFixed(data.digits)) + 0).toLocaleString("en-US", fixed));
  const words = (arm, k) => {
    const { first, mean, low, high } = arm[panel], i = k - first;
    if (i < 0) return "trains its sources";
    const bounds = Number.isNaN(low[i]) ? "" : ` [${written(low[i])}, ${written(high[i])}]`;
    return written(mean[i]) + bounds;
  };

  // Round numbers between two, so many at most.
  const ticks = (low, high, most) => {
    const least = (high - low) / most, power = 10 ** Math.floor(Math.log10(least)), marks = [];
    const step = power * [1, 2, 5, 10].find((item) => item * power >= least * 0.999);
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high * (1 + 1e-12); k++) marks.push(k * step + 0);
    return marks;
  };
  const returnTicks = ([low, high], space) => {
    const even = ticks(valueAt(low), valueAt(high), space / 40);
    if (!data.symlog) return even;
    const marks = [], apart = (26 / space) * (high - low), powers = [...Array(24).keys()];
    const sizes = [1, 5, 2].flatMap((digit) => powers.map((item) => digit * 10 ** (item - 9)));
    for (const item of [0, ...sizes, ...sizes.map((size) => -size)]) {
      const height = heightOf(item), far = (other) => Math.abs(heightOf(other) - height) >= apart;
      if (height >= low && height <= high && marks.every(far)) marks.push(item);
    }
    return marks.length < 3 ? even : marks;
  };

  const dress = (element, settings) => {
    for (const [key, value] of Object.entries(settings)) element.setAttribute(key, value);
    return element;
  };
  const add = (parent, name, settings, text = "") => {
    const made = dress(document.createElementNS(SVG, name), settings);
    made.textContent = text;
    parent.append(made);
    return made;
  };
  const lineOf = (xs, ys, { x, y }) =>
    `M${xs.map((item, i) => `${x(item).toFixed(1)} ${y(ys[i]).toFixed(1)}`).join("L")}`;

  // An arm twice: below all lines its band, which has no height where a bound does not exist.
  const drawBand = (parent, arm, to) => {
    const { steps: xs, mean, low, high } = arm[panel];
    const bound = (values) => values.map((item, i) => (Number.isNaN(item) ? mean[i] : item));
    const outline = [...bound(low), ...bound(high).reverse()];
    const d = lineOf([...xs, ...[...xs].reverse()], outline, to);
    const look = { fill: arm.colour, "fill-opacity": 0.18, display: hides(arm.name) ? "none" : "inline" };
    add(parent, "path", { "data-arm": arm.name, class: "band", d, ...look });
  };
  const drawLines = (parent, arm, to) => {
    const { first, steps: [start], steps: xs, mean } = arm[panel], end = data.panels[panel].x[1];
    const group = add(parent, "g", { "data-arm": arm.name, fill: "none", stroke: arm.colour });
    const line = (ours, returns, look) => add(group, "path", { d: lineOf(ours, returns, to), ...look });
    if (at("chart-seeds").checked) {
      arm.seeds.forEach((row, k) => {
        const shift = panel === "strong" ? arm.source_steps[k] : 0;
        const counted = seedSteps.map((item) => item + shift).filter((item) => item <= end);
        if (counted.length) line(counted, row, { class: "seed", "stroke-width": 0.8, opacity: 0.5 });
      });
    }
    const dotted = { stroke: "#555", "stroke-dasharray": "1.5 3", "stroke-width": 1.4 };
    if (first) line([0, start, start], [data.random, data.random, mean[0]], dotted);
    line(xs, mean, { class: "mean", "stroke-width": 2, "stroke-dasharray": arm.dashes });
  };

  // Draw what is shown, on the page or for a file, and return the scales.
  const picture = (svg, width, height) => {
    const { x: [x0, x1], y: [y0, y1] } = current();
    const top = 26, bottom = height - 42, right = width - 34, marks = returnTicks([y0, y1], bottom - top);
    const left = 14 + 7.5 * Math.max(...marks.map((item) => label(item).length));
    const x = (item) => left + ((item - x0) / (x1 - x0)) * (right - left);
    const y = (item) => bottom - ((heightOf(item) - y0) / (y1 - y0)) * (bottom - top);
    dress(svg, { viewBox: `0 0 ${width} ${height}`, width, height });
    dress(svg, { fill: GREY, "font-family": "system-ui, sans-serif", "font-size": 12 }).replaceChildren();
    add(svg, "rect", { width: "100%", height: "100%", fill: "#fff" });
    for (const item of marks) {
      add(svg, "path", { d: `M${left} ${y(item)}H${right}`, stroke: RULE });
      add(svg, "text", { x: left - 7, y: y(item) + 4, "text-anchor": "end" }, label(item));
    }
    for (const item of ticks(x0, x1, (right - left) / 80)) {
      add(svg, "path", { d: `M${x(item)} ${bottom}v5`, stroke: GREY });
      add(svg, "text", { x: x(item), y: bottom + 19, "text-anchor": "middle" }, label(item));
    }
    add(svg, "path", { d: `M${left} ${top}V${bottom}H${right}`, stroke: GREY, fill: "none" });
    add(svg, "text", { x: 2, y: 13 }, `${data.unit}${data.symlog ? " (symlog scale)" : ""}`);
    const counted = panel === "strong" ? "target and source steps" : "target steps";
    add(svg, "text", { x: right, y: height - 6, "text-anchor": "end" }, counted);
    const frame = { x: left, y: top - 3, width: right - left + 3, height: bottom - top + 6 };
    add(add(svg, "clipPath", { id: "chart-frame" }), "rect", frame);
    const inside = add(svg, "g", { "clip-path": "url(#chart-frame)" }), level = y(data.threshold);
    add(inside, "path", { d: `M${left} ${level}H${right}`, stroke: "#777" });
    const drawn = at("chart-seeds").checked ? [drawLines] : [drawBand, drawLines];
    drawn.forEach((item) => shownArms().forEach((arm) => item(inside, arm, { x, y })));
    // The word stands on that side of its line where no curve ends.
    const above = shownArms().map((arm) => level - y(arm[panel].mean.at(-1))).some((up) => up > -2 && up < 22);
    const halo = { stroke: "#fff", "stroke-width": 3, "paint-order": "stroke", "font-size": 11 };
    const place = { x: right - 2, y: level + (above ? 13 : -4), "text-anchor": "end" };
    add(inside, "text", { ...place, ...halo }, `threshold ${data.threshold_words}`);
    return { x, y, left, right, top, bottom, over: add(svg, "g", {}) };
  };

  const drawCursor = () => {
    const k = cursor === null ? last() : cursor, { x, y, left, right, top, bottom, over } = scales;
    at("chart-steps").textContent = `${cursor === null ? "At the end, " : "At "}${label(steps[k])} steps`;
    rows.forEach((row, n) => { row.querySelector(".value").textContent = words(listed[n], k); });
    const values = shownArms().map((arm) => `${arm.name} ${words(arm, k)}`);
    const said = `${label(steps[k])} steps: ${values.join("; ")}`;
    dress(chart, { "aria-valuemax": steps[last()], "aria-valuenow": steps[k], "aria-valuetext": said });
    over.replaceChildren();
    chart.querySelectorAll(".band").forEach((item) => {
      dress(item, { display: hides(item.dataset.arm) ? "none" : "inline" });
    });
    rows.forEach((row, n) => row.classList.toggle("nearest", listed[n].name === nearest && shownArms().length > data.most_bands));
    if (drag?.box) add(over, "rect", { ...drag.box, fill: "#0072b2", "fill-opacity": 0.12, stroke: "#0072b2" });
    if (cursor === null || x(steps[k]) < left - 1 || x(steps[k]) > right + 1) return;
    add(over, "path", { d: `M${x(steps[k])} ${top}V${bottom}`, stroke: "#111", "stroke-dasharray": "3 3" });
    for (const arm of shownArms().filter((item) => k >= item[panel].first)) {
      const cy = y(arm[panel].mean[k - arm[panel].first]);
      const dot = { cx: x(steps[k]), cy, r: 4, fill: arm.colour, stroke: "#fff" };
      if (cy > top - 4 && cy < bottom + 4) add(over, "circle", dot);
    }
  };
  const draw = () => {
    const width = at("chart-place").clientWidth;
    if (!width) return;
    scales = picture(chart, width, Math.round(Math.max(300, Math.min(470, width * 0.56))));
    at("chart-reset").disabled = !views[panel];
    drawCursor();
  };

  // Zoom to steps. Unless heights are given too, they are those of what lies between these steps.
  const zoom = (low, high, heights) => {
    const [start, end] = whole().x, least = 2 * (steps[1] - steps[0]);
    const length = Math.min(end - start, Math.max(least, high - low));
    const from = Math.max(start, Math.min(end - length, (low + high - length) / 2)), to = from + length;
    const seen = shownArms().flatMap(({ [panel]: { steps: xs, mean, low, high } }) =>
      [mean, low, high].flatMap((row) => row.filter((item, i) => xs[i] >= from && xs[i] <= to && item === item)));
    const [bottom, top] = [Math.min, Math.max].map((end) => heightOf(end(...seen)));
    const margin = 0.06 * (top - bottom);
    const fitting = margin > 0 ? [bottom - margin, top + margin] : whole().y;
    views[panel] = length >= end - start && !heights ? null : { x: [from, to], y: (heights || fitting).map(valueAt) };
    draw();
  };
  const scaled = (factor) => {
    const [low, high] = current().x, middle = cursor === null ? (low + high) / 2 : steps[cursor];
    zoom(middle - ((high - low) * factor) / 2, middle + ((high - low) * factor) / 2);
  };
  const reset = () => zoom(...whole().x);
  const move = (k) => {
    cursor = Math.max(0, Math.min(last(), k));
    const [low, high] = current().x, half = (high - low) / 2, there = steps[cursor];
    if (there < low || there > high) zoom(there - half, there + half);
    else drawCursor();
  };

  // The pointer: it reads values; a mouse that is dragged zooms, a finger does not.
  const between = (share, [first, end]) => first + share * (end - first);
  const stepsAt = (x) => between((x - scales.left) / (scales.right - scales.left), current().x);
  const heightAt = (y) => between((scales.bottom - y) / (scales.bottom - scales.top), current().y);
  const point = ({ clientX, clientY }) => {
    const box = chart.getBoundingClientRect(), wanted = stepsAt(clientX - box.left);
    const away = steps.slice(0, last() + 1).map((item) => Math.abs(item - wanted));
    cursor = away.indexOf(Math.min(...away));
    const begun = shownArms().filter((arm) => cursor >= arm[panel].first);
    const apart = (arm) => Math.abs(scales.y(arm[panel].mean[cursor - arm[panel].first]) - (clientY - box.top));
    nearest = begun.length ? begun.reduce((a, b) => (apart(b) <= apart(a) ? b : a)).name : null;
    return [clientX - box.left, clientY - box.top];
  };
  chart.addEventListener("pointerdown", (event) => {
    const from = point(event);
    drawCursor();
    if (event.pointerType === "touch" || event.button) return;
    drag = { from };
    chart.setPointerCapture(event.pointerId);
  });
  chart.addEventListener("pointermove", (event) => {
    const to = point(event);
    if (drag) {
      const [x, y] = [0, 1].map((i) => Math.min(drag.from[i], to[i]));
      const [width, height] = [0, 1].map((i) => Math.abs(drag.from[i] - to[i]));
      drag.flat = height < 20;
      const tall = drag.flat ? { y: scales.top, height: scales.bottom - scales.top } : { y, height };
      drag.box = width < 8 ? null : { x, width, ...tall };
    }
    drawCursor();
  });
  chart.addEventListener("pointerup", () => {
    const { box, flat } = drag || {};
    drag = null;
    if (!box) return;
    const heights = flat ? null : [heightAt(box.y + box.height), heightAt(box.y)];
    zoom(stepsAt(box.x), stepsAt(box.x + box.width), heights);
  });
  const leave = (event) => {
    if (event.type === "pointerleave" && (event.pointerType === "touch" || drag)) return;
    drag = cursor = nearest = null;
    drawCursor();
  };
  for (const name of ["pointerleave", "pointercancel"]) chart.addEventListener(name, leave);
  chart.addEventListener("dblclick", reset);
  chart.addEventListener("keydown", (event) => {
    const k = cursor === null ? last() : cursor, far = Math.ceil(last() / 10);
    const places = { ArrowLeft: k - 1, ArrowDown: k - 1, ArrowRight: k + 1, ArrowUp: k + 1 };
    const zooms = { "+": 0.5, "=": 0.5, "-": 2 };
    Object.assign(places, { Home: 0, End: last(), PageUp: k + far, PageDown: k - far });
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key in places) move(places[event.key]);
    else if (event.key in zooms) scaled(zooms[event.key]);
    else if (event.key === "0" || event.key === "Escape") reset();
    else return;
    event.preventDefault();
  });

  // The legend: each arm is a button, with its value beside it.
  const turn = (n, on) => {
    listed[n].shown = on;
    dress(rows[n].querySelector("button"), { "aria-pressed": on });
    draw();
  };
  rows.forEach((row, n) => {
    const button = document.createElement("button"), value = document.createElement("span");
    button.type = "button";
    value.className = "value";
    button.append(...row.childNodes);
    row.append(button, value);
    dress(button, { "aria-pressed": listed[n].shown });
    button.addEventListener("click", () => turn(n, !listed[n].shown));
    const fade = (opacity) => chart.querySelectorAll("[data-arm]").forEach((group) => {
      dress(group, { opacity: group.dataset.arm === listed[n].name ? 1 : opacity });
    });
    const name = (arm, opacity) => { nearest = arm; fade(opacity); drawCursor(); };
    row.addEventListener("pointerenter", () => name(listed[n].name, listed[n].shown ? 0.15 : 1));
    row.addEventListener("pointerleave", () => name(null, 1));
  });
  at("chart-controls")?.addEventListener("change", (event) => {
    listed.forEach((arm, n) => { if (arm.control) turn(n, event.target.checked); });
  });
  at("chart-seeds").addEventListener("change", draw);
  const change = () => {
    panel = at("axis-weak").checked ? "weak" : "strong";
    cursor = null;
    draw();
  };
  for (const name of ["weak", "strong"]) at(`axis-${name}`).addEventListener("change", change);

  // Files: what is shown, with the names of its arms below.
  const saved = () => {
    const svg = document.createElementNS(SVG, "svg"), on = listed.filter((arm) => arm.shown);
    const [width, height] = [900, 480], all = height + 20 * on.length + 8;
    picture(svg, width, height);
    dress(svg, { height: all, viewBox: `0 0 ${width} ${all}` });
    on.forEach((arm, n) => {
      const y = height + 12 + 20 * n, line = { stroke: arm.colour, "stroke-width": 3 };
      add(svg, "path", { d: `M20 ${y}h34`, ...line, "stroke-dasharray": arm.dashes });
      add(svg, "text", { x: 64, y: y + 4 }, arm.name);
    });
    return new XMLSerializer().serializeToString(svg);
  };
  const download = (href, ending) => {
    const name = `learning-curves-${panel}.${ending}`;
    Object.assign(document.createElement("a"), { href, download: name }).click();
  };
  const address = () => `data:image/svg+xml;charset=utf-8,${encodeURIComponent(saved())}`;
  const png = () => {
    const image = new Image(), canvas = document.createElement("canvas");
    image.addEventListener("load", () => {
      dress(canvas, { width: 2 * image.width, height: 2 * image.height });
      canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
      download(canvas.toDataURL(), "png");
    });
    image.src = address();
  };

  const buttons = { in: () => scaled(0.5), out: () => scaled(2), reset, png };
  buttons.svg = () => download(address(), "svg");
  for (const [name, act] of Object.entries(buttons)) at(`chart-${name}`).addEventListener("click", act);
  change();
  new ResizeObserver(draw).observe(at("chart-place"));
  at("curves").classList.add("answering");
});
