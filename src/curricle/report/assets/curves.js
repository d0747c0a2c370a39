"use strict";
// Learning curves that answer: values at a checkpoint, zoom, arms on and off, seeds, pictures.
document.addEventListener("DOMContentLoaded", () => {
  const at = (id) => document.getElementById(id);
  const data = JSON.parse(at("curves-data").textContent), unit = 10 ** data.digits;
  const svgs = "http://www.w3.org/2000/svg", chart = at("chart"), list = at("arms");
  const summed = (rows, by = 1) => {
    let sum = 0;
    return rows.map((one) => (one === null ? NaN : (sum += one) / by));
  };
  const steps = summed(data.steps), seedSteps = summed(data.seed_steps);
  const arms = data.arms.map((arm) => {
    const own = { ...arm, on: true, seeds: arm.seeds.map((row) => summed(row, unit)) };
    for (const panel of ["weak", "strong"]) {
      const { first, mean, low, high } = arm[panel];
      own[panel] = { first, mean: summed(mean, unit), low: summed(low, unit), high: summed(high, unit) };
      own[panel].steps = steps.slice(first, first + mean.length);
    }
    return own;
  });

  // What is shown. Returns are kept as places on the axis, which is logarithmic where it says so.
  let panel = "strong", view = null, cursor = null, bright = null, drag = null;
  const [linear, decades] = data.symlog || [Infinity, 1];
  const place = (y) => Math.abs(y) <= linear ? y * decades / 0.9
    : Math.sign(y) * linear * (decades / 0.9 + Math.log10(Math.abs(y) / linear));
  const valueAt = (p) => Math.abs(p) <= linear * decades / 0.9 ? p * 0.9 / decades
    : Math.sign(p) * linear * 10 ** (Math.abs(p) / linear - decades / 0.9);
  const whole = () => ({ x: data.panels[panel].x, y: data.panels[panel].y.map(place) });
  const shown = () => view || whole();

  const grouped = (n, digits = 0) => {
    const text = Math.abs(n).toLocaleString("en-US", { minimumFractionDigits: digits, maximumFractionDigits: digits });
    return (n < 0 && /[1-9]/.test(text) ? "\u2212" : "") + text;
  };
  const words = (arm, k) => {
    const own = arm[panel], i = k - own.first;
    if (i < 0) return "in its sources";
    const [mean, low, high] = [own.mean[i], own.low[i], own.high[i]].map((one) => grouped(one, data.digits));
    return Number.isNaN(own.low[i]) ? mean : `${mean} [${low}, ${high}]`;
  };
  const last = () => arms[0][panel].first + arms[0][panel].mean.length - 1;

  const element = (parent, name, settings, text) => {
    const made = document.createElementNS(svgs, name);
    for (const [key, value] of Object.entries(settings)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    parent.append(made);
    return made;
  };

  // Round numbers between two, as far apart as the space allows.
  const ticks = (low, high, most) => {
    const least = (high - low) / Math.max(1, most), power = 10 ** Math.floor(Math.log10(least));
    const step = [1, 2, 5, 10].find((one) => one * power >= least) * power, found = [];
    for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(k * step);
    return { found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
  };
  const returnTicks = ([low, high], height) => {
    const even = ticks(valueAt(low), valueAt(high), height / 45);
    if (!data.symlog) return even;
    const found = [], apart = (high - low) * 24 / height;
    for (let power = Math.floor(Math.log10(linear)) - 1; power < 16; power++) {
      for (const size of [1, 5, 2].map((one) => one * 10 ** power)) found.push(size, -size);
    }
    found.sort((a, b) => Math.abs(Math.log10(Math.abs(a)) % 1) - Math.abs(Math.log10(Math.abs(b)) % 1));
    const kept = [];
    for (const one of [0, ...found]) {
      const p = place(one);
      if (p >= low && p <= high && kept.every((other) => Math.abs(place(other) - p) >= apart)) kept.push(one);
    }
    return kept.length < 4 ? even : { found: kept, digits: 0, free: true };
  };

  const path = (xs, ys, x, y) => {
    let text = "", pen = "M";
    xs.forEach((one, i) => {
      if (Number.isNaN(ys[i])) { pen = "M"; return; }
      text += `${pen}${x(one).toFixed(1)} ${y(ys[i]).toFixed(1)}`;
      pen = "L";
    });
    return text;
  };
  // Bounds may be missing at some checkpoints: each stretch that has them is a shape of its own.
  const bandPath = ({ steps: xs, low, high }, x, y) => {
    let text = "", stretch = [];
    for (let i = 0; i <= xs.length; i++) {
      if (i < xs.length && !Number.isNaN(low[i])) { stretch.push(i); continue; }
      const there = stretch.map((k) => `${x(xs[k]).toFixed(1)} ${y(low[k]).toFixed(1)}`);
      const back = stretch.reverse().map((k) => `${x(xs[k]).toFixed(1)} ${y(high[k]).toFixed(1)}`);
      if (there.length) text += `M${[...there, ...back].join("L")}Z`;
      stretch = [];
    }
    return text;
  };

  const drawArm = (parent, arm, x, y) => {
    const own = arm[panel], dim = bright && bright !== arm;
    const group = element(parent, "g", { "data-arm": arm.name, fill: "none", opacity: dim ? 0.15 : 1 });
    const line = (d, settings) => element(group, "path", { d, stroke: arm.colour, ...settings });
    if (at("chart-seeds").checked) {
      arm.seeds.forEach((row, k) => {
        const end = panel === "weak" ? data.panels.weak.x[1] : data.panels.strong.x[1];
        const xs = seedSteps.map((one) => one + (panel === "strong" ? arm.source_steps[k] : 0)).filter((one) => one <= end);
        line(path(xs, row, x, y), { class: "seed", "stroke-width": 0.7, "stroke-opacity": 0.45 });
      });
    } else {
      line(bandPath(own, x, y), { class: "band", fill: arm.colour, "fill-opacity": 0.18, stroke: "none" });
    }
    if (own.first > 0) {
      const [start, low] = [own.steps[0], data.random];
      line(path([0, start, start], [low, low, own.mean[0]], x, y), { stroke: "#555", "stroke-dasharray": "1.5 3", "stroke-width": 1.4 });
    }
    line(path(own.steps, own.mean, x, y), { class: "mean", "stroke-width": 2, "stroke-dasharray": arm.dashes, "stroke-linejoin": "round" });
  };

  // One picture of what is shown, on the page or to be saved; returns its scales.
  const picture = (svg, width, height) => {
    const { x: [x0, x1], y: [y0, y1] } = shown();
    const down = returnTicks([y0, y1], height - 64);
    const label = (one) => down.free ? grouped(one, Math.max(0, -Math.floor(Math.log10(Math.abs(one) || 1)))) : grouped(one, down.digits);
    const left = 14 + 7.5 * Math.max(...down.found.map((one) => label(one).length)), right = width - 18, top = 26, bottom = height - 42;
    const x = (one) => left + (one - x0) / (x1 - x0) * (right - left);
    const y = (one) => bottom - (place(one) - y0) / (y1 - y0) * (bottom - top);
    svg.replaceChildren();
    for (const [key, value] of Object.entries({ viewBox: `0 0 ${width} ${height}`, width, height, "font-family": "system-ui, sans-serif", "font-size": 12, fill: "#444" })) svg.setAttribute(key, value);
    element(svg, "rect", { width, height, fill: "#fff" });
    const text = (words, settings) => element(svg, "text", settings, words);
    for (const one of down.found) {
      element(svg, "path", { d: `M${left} ${y(one)}H${right}`, stroke: "#e4e4e4" });
      text(label(one), { x: left - 7, y: y(one) + 4, "text-anchor": "end" });
    }
    const across = ticks(x0, x1, (right - left) / 95);
    for (const one of across.found) {
      element(svg, "path", { d: `M${x(one)} ${bottom}v5`, stroke: "#444" });
      text(grouped(one, across.digits), { x: x(one), y: bottom + 19, "text-anchor": x(one) > right - 25 ? "end" : "middle", ...(x(one) > right - 25 && { x: right + 16 }) });
    }
    element(svg, "path", { d: `M${left} ${top}V${bottom}H${right}`, stroke: "#444", fill: "none" });
    text(`greedy return${data.symlog ? " (symlog scale)" : ""}`, { x: 2, y: 13 });
    text(panel === "strong" ? "target and source steps" : "target steps", { x: right, y: height - 6, "text-anchor": "end" });
    const clip = element(element(svg, "clipPath", { id: "chart-clip" }), "rect", { x: left, y: top - 3, width: right - left + 3, height: bottom - top + 6 });
    const inside = element(svg, "g", { "clip-path": `url(#${clip.parentNode.id})` });
    element(inside, "path", { class: "threshold", d: `M${left} ${y(data.threshold)}H${right}`, stroke: "#777" });
    arms.filter((arm) => arm.on).forEach((arm) => drawArm(inside, arm, x, y));
    element(inside, "text", { x: right - 2, y: y(data.threshold) - 4, "text-anchor": "end", "font-size": 11, stroke: "#fff", "stroke-width": 3, "paint-order": "stroke" }, `threshold ${data.threshold_words}`);
    return { x, y, left, right, top, bottom, over: element(svg, "g", {}) };
  };

  let scales;
  const drawCursor = () => {
    const k = cursor === null ? last() : cursor, { x, y, top, bottom, over } = scales;
    at("chart-steps").textContent = `${cursor === null ? "At the end, " : "At "}${grouped(steps[k])} steps`;
    list.querySelectorAll("li").forEach((row, n) => {
      row.querySelector(".value").textContent = words(named[n], k);
    });
    over.replaceChildren();
    const said = arms.filter((arm) => arm.on).map((arm) => `${arm.name} ${words(arm, k)}`).join("; ");
    for (const [key, value] of Object.entries({ "aria-valuemin": 0, "aria-valuemax": steps[last()], "aria-valuenow": steps[k], "aria-valuetext": `${grouped(steps[k])} steps: ${said}` })) chart.setAttribute(key, value);
    if (drag && drag.box) element(over, "rect", { ...drag.box, fill: "#0072b2", "fill-opacity": 0.12, stroke: "#0072b2" });
    if (cursor === null || x(steps[k]) < scales.left - 1 || x(steps[k]) > scales.right + 1) return;
    element(over, "path", { d: `M${x(steps[k])} ${top}V${bottom}`, stroke: "#111", "stroke-dasharray": "3 3" });
    for (const arm of arms.filter((one) => one.on && k >= one[panel].first)) {
      const height = y(arm[panel].mean[k - arm[panel].first]);
      if (height > top - 4 && height < bottom + 4) element(over, "circle", { cx: x(steps[k]), cy: height, r: 4, fill: arm.colour, stroke: "#fff" });
    }
  };
  const draw = () => {
    const width = at("chart-place").clientWidth;
    if (!width) return;
    scales = picture(chart, width, Math.round(Math.max(300, Math.min(460, width * 0.55))));
    at("chart-reset").disabled = !view;
    drawCursor();
  };

  // Zoom. Without bounds for the returns they are those of what is drawn between the steps.
  const zoom = (low, high, returns) => {
    const { x: [first, end] } = whole(), least = 2 * (steps[1] - steps[0]);
    const length = Math.min(end - first, Math.max(least, high - low));
    const start = Math.max(first, Math.min(end - length, (low + high - length) / 2));
    if (length >= end - first && !returns) { view = null; draw(); return; }
    if (!returns) {
      const seen = arms.filter((arm) => arm.on).flatMap((arm) => arm[panel].steps.flatMap((one, i) =>
        one < start || one > start + length ? [] : [arm[panel].mean[i], arm[panel].low[i], arm[panel].high[i]]));
      const ends = seen.filter((one) => !Number.isNaN(one)).map(place);
      const [least, most] = [Math.min(...ends), Math.max(...ends)], margin = 0.06 * (most - least);
      returns = margin > 0 ? [least - margin, most + margin] : whole().y;
    }
    view = { x: [start, start + length], y: returns };
    draw();
  };
  const scaled = (factor) => {
    const [low, high] = shown().x, middle = cursor === null ? (low + high) / 2 : steps[cursor];
    const length = (high - low) * factor;
    zoom(middle - length / 2, middle + length / 2);
  };
  const reset = () => { view = null; draw(); };
  const move = (k) => {
    cursor = Math.max(0, Math.min(last(), k));
    const [low, high] = shown().x, half = (high - low) / 2;
    if (steps[cursor] < low || steps[cursor] > high) zoom(steps[cursor] - half, steps[cursor] + half);
    else drawCursor();
  };

  const stepsAt = (left) => {
    const [x0, x1] = shown().x;
    return x0 + (left - scales.left) / (scales.right - scales.left) * (x1 - x0);
  };
  const pointed = (event) => {
    const box = chart.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const point = ([left]) => {
    const wanted = stepsAt(left), [low, high] = shown().x;
    let best = 0;
    for (let k = 0; k <= last(); k++) {
      if (steps[k] >= low && steps[k] <= high && Math.abs(steps[k] - wanted) < Math.abs(steps[best] - wanted)) best = k;
    }
    cursor = best;
  };
  chart.addEventListener("pointerdown", (event) => {
    if (event.pointerType !== "touch" && event.button === 0) { drag = { from: pointed(event) }; chart.setPointerCapture(event.pointerId); }
    point(pointed(event));
    drawCursor();
  });
  chart.addEventListener("pointermove", (event) => {
    const to = pointed(event);
    point(to);
    if (drag) {
      const [x, y] = [0, 1].map((i) => Math.min(drag.from[i], to[i])), [width, height] = [0, 1].map((i) => Math.abs(drag.from[i] - to[i]));
      const flat = height < 20; // A drag along the axis chooses steps, any other a part of the picture.
      drag.box = width < 8 ? null : { x, width, y: flat ? scales.top : y, height: flat ? scales.bottom - scales.top : height };
      drag.flat = flat;
    }
    drawCursor();
  });
  chart.addEventListener("pointerup", () => {
    const { box, flat } = drag || {};
    drag = null;
    if (!box) { drawCursor(); return; }
    const [y0, y1] = shown().y, at = (y) => y1 - (y - scales.top) / (scales.bottom - scales.top) * (y1 - y0);
    zoom(stepsAt(box.x), stepsAt(box.x + box.width), flat ? undefined : [at(box.y + box.height), at(box.y)]);
  });
  const leave = () => { drag = null; cursor = null; drawCursor(); };
  chart.addEventListener("pointerleave", (event) => { if (event.pointerType !== "touch" && !drag) leave(); });
  chart.addEventListener("pointercancel", leave);
  chart.addEventListener("dblclick", reset);
  chart.addEventListener("keydown", (event) => {
    const k = cursor === null ? last() : cursor, far = Math.ceil(last() / 10);
    const moves = { ArrowLeft: k - 1, ArrowDown: k - 1, ArrowRight: k + 1, ArrowUp: k + 1, Home: 0, End: last(), PageUp: k + far, PageDown: k - far };
    const acts = { "+": () => scaled(0.5), "=": () => scaled(0.5), "-": () => scaled(2), 0: reset, Escape: reset };
    if (event.ctrlKey || event.metaKey || event.altKey || !(event.key in moves || event.key in acts)) return;
    event.preventDefault();
    if (event.key in moves) move(moves[event.key]);
    else acts[event.key]();
  });

  // The legend: each arm is a button, with its value beside it.
  const named = [...list.querySelectorAll("li")].map((row) => arms.find((arm) => arm.name === row.dataset.arm));
  const press = (n, on) => {
    named[n].on = on;
    list.querySelectorAll("button")[n].setAttribute("aria-pressed", on);
  };
  list.querySelectorAll("li").forEach((row, n) => {
    const button = document.createElement("button"), value = document.createElement("span");
    button.type = "button";
    value.className = "value";
    button.append(...row.childNodes);
    row.append(button, value);
    button.addEventListener("click", () => { press(n, !named[n].on); draw(); });
    const light = (arm) => { bright = arm; draw(); };
    row.addEventListener("pointerenter", () => light(named[n].on ? named[n] : null));
    row.addEventListener("pointerleave", () => light(null));
    press(n, true);
  });
  const controls = at("chart-controls");
  if (controls) controls.addEventListener("change", () => {
    named.forEach((arm, n) => { if (arm.control) press(n, controls.checked); });
    draw();
  });
  at("chart-seeds").addEventListener("change", draw);
  at("chart-in").addEventListener("click", () => scaled(0.5));
  at("chart-out").addEventListener("click", () => scaled(2));
  at("chart-reset").addEventListener("click", reset);
  for (const name of ["weak", "strong"]) at(`axis-${name}`).addEventListener("change", () => { panel = name; view = null; cursor = null; draw(); });

  // Pictures to keep: what is shown, with the names of its arms below.
  const saved = () => {
    const svg = document.createElementNS(svgs, "svg"), on = named.filter((arm) => arm.on), [width, height] = [900, 480];
    picture(svg, width, height);
    svg.setAttribute("height", height + 20 * on.length + 8);
    svg.setAttribute("viewBox", `0 0 ${width} ${height + 20 * on.length + 8}`);
    svg.firstChild.setAttribute("height", height + 20 * on.length + 8);
    on.forEach((arm, n) => {
      const y = height + 12 + 20 * n;
      element(svg, "path", { d: `M20 ${y}h34`, stroke: arm.colour, "stroke-width": 3, "stroke-dasharray": arm.dashes });
      element(svg, "text", { x: 64, y: y + 4 }, arm.name);
    });
    return new XMLSerializer().serializeToString(svg);
  };
  const download = (blob, ending) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = `learning-curves-${panel}.${ending}`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  };
  at("chart-svg").addEventListener("click", () => download(new Blob([saved()], { type: "image/svg+xml" }), "svg"));
  at("chart-png").addEventListener("click", () => {
    const image = new Image(), canvas = document.createElement("canvas");
    image.onload = () => {
      [canvas.width, canvas.height] = [2 * image.width, 2 * image.height];
      canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
      canvas.toBlob((blob) => download(blob, "png"));
    };
    image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(saved())}`;
  });

  at("curves").classList.add("answering");
  new ResizeObserver(draw).observe(at("chart-place"));
  draw();
});
