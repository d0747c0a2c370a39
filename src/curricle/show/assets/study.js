"use strict";
document.documentElement.classList.add("js");
document.addEventListener("DOMContentLoaded", () => {
  // What is wider than the page says that it scrolls.
  const wide = new ResizeObserver((entries) => entries.forEach(({ target }) => {
    target.classList.toggle("scrolls", target.scrollWidth > target.clientWidth + 1);
  }));
  document.querySelectorAll(".across").forEach((box) => wide.observe(box));
  const { replays, palettes } = JSON.parse(document.getElementById("replays").textContent);
  const which = document.getElementById("which");
  if (!which) return;
  const at = (id) => document.getElementById(id);
  const moment = at("moment"), tick = at("tick");
  const SHADES = 64, LEVELS = 65536;
  const grouped = (n) => n.toLocaleString("en-US");
  const written = (value, digits) => {
    const text = value.toFixed(digits);
    return (Number(text) === 0 ? (0).toFixed(digits) : text).replace("-", "\u2212");
  };

  // Sixteen-bit numbers, the lower byte first, as every machine with a browser stores them.
  const unpacked = (text) => new Uint16Array(Uint8Array.from(atob(text), (char) => char.charCodeAt(0)).buffer);

  // A button that moves a slider to its end, or stops it.
  const player = (button, slider, pause, draw) => {
    let timer = 0;
    const stop = () => { clearInterval(timer); timer = 0; button.textContent = "Play"; };
    const step = () => {
      if (slider.valueAsNumber < Number(slider.max)) { slider.value = slider.valueAsNumber + 1; draw(); }
      if (slider.valueAsNumber >= Number(slider.max)) stop();
    };
    button.addEventListener("click", () => {
      if (timer) { stop(); return; }
      if (slider.valueAsNumber >= Number(slider.max)) { slider.value = 0; draw(); }
      button.textContent = "Pause";
      timer = setInterval(step, pause());
    });
    slider.addEventListener("input", () => { stop(); draw(); });
    return stop;
  };

  let replay, levels, still;
  const drawMoment = () => {
    const svg = at("map").firstElementChild, f = moment.valueAsNumber, n = replay.cells.length / 2;
    const heat = new Array(SHADES).fill(""), middle = replay.digits === null ? 0.5 : 0.4;
    const words = svg.querySelectorAll(".words text"), numbers = svg.querySelectorAll(".numbers text");
    let choice = "";
    for (let i = 0; i < n; i++) {
      const [x, y] = [replay.cells[2 * i], replay.cells[2 * i + 1]], level = levels[f * n + i];
      const mark = replay.marks[replay.choices[f].charCodeAt(i) - 48];
      heat[Math.floor(level * SHADES / LEVELS)] += `M${x} ${y}h1v1h-1z`;
      if (replay.arrows) choice += mark && `M${x}.5 ${y + middle}${mark}`;
      else words[i].textContent = mark;
      if (replay.digits !== null) {
        const value = replay.low + (replay.high - replay.low) * level / (LEVELS - 1);
        numbers[i].textContent = written(value, replay.digits);
      }
    }
    svg.querySelectorAll(".heat path").forEach((path, shade) => path.setAttribute("d", heat[shade]));
    svg.querySelector(".choice").setAttribute("d", choice);
    const now = `Step ${grouped(replay.steps[f])} of ${grouped(replay.steps.at(-1))}`;
    at("moment-words").textContent = now;
    moment.setAttribute("aria-valuetext", now);
    svg.setAttribute("aria-label", `Values and choices. ${now}`);
  };
  const drawEpisodes = () => {
    for (const name of ["before", "after"]) {
      const episode = replay.episodes[name], last = episode.places.length - 1;
      const t = Math.min(tick.valueAsNumber, last), holder = at(name);
      holder.querySelectorAll(".marker").forEach((marker, k) => {
        const [x, y] = episode.places[t].slice(2 * k);
        marker.style.transform = `translate(${x}px, ${y}px)`;
      });
      holder.querySelectorAll(".trail").forEach((trail, k) => {
        const way = episode.places.slice(0, t + 1).map((place) => place.slice(2 * k, 2 * k + 2));
        trail.setAttribute("points", way.join(" "));
      });
      const [text, code] = episode.drawings[episode.drawn[t]] || ["", ""];
      const picture = holder.querySelector("img.own"), words = holder.querySelector("pre.own");
      if (picture) {
        picture.hidden = !code;
        picture.alt = text || "As the environment draws it";
        if (code) picture.src = `data:image/png;base64,${code}`;
        words.hidden = Boolean(code);
        words.textContent = text;
      }
      holder.querySelector(".outcome").textContent =
        t === last ? episode.words : `step ${t}, return so far ${episode.returns[t]}`;
    }
    tick.setAttribute("aria-valuetext", `Step ${tick.value} of ${tick.max}`);
  };

  const stops = [
    player(at("map-play"), moment, () => 180, drawMoment),
    // Long episodes are played faster: in twenty seconds at most.
    player(at("episode-play"), tick, () => Math.max(60, Math.min(350, 20000 / Number(tick.max))), drawEpisodes),
  ];
  const show = () => {
    stops.forEach((stop) => stop());
    replay = replays[which.value];
    levels = unpacked(replay.levels);
    still = document.querySelector(`.still[data-key="${which.value}"]`);
    const svg = still.querySelector(".moments figure:last-child svg").cloneNode(true);
    const heat = svg.querySelector(".heat");
    heat.replaceChildren(...palettes[replay.palette].map((colour) => {
      const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
      path.setAttribute("fill", colour);
      return path;
    }));
    at("map").replaceChildren(svg);
    at("map-words").textContent = still.querySelector(".small").textContent;
    at("scale").replaceChildren(still.querySelector(".scale").cloneNode(true));
    moment.max = replay.steps.length - 1;
    moment.value = moment.max;
    drawMoment();
    const shown = "before" in replay.episodes;
    at("episodes").hidden = !shown;
    at("no-episodes").hidden = shown;
    if (!shown) return;
    at("pair").className = still.querySelector(".pair").className;
    for (const name of ["before", "after"]) {
      at(name).replaceChildren(still.querySelector(`.episode[data-which="${name}"]`).cloneNode(true));
    }
    const longest = Math.max(...["before", "after"].map((name) => replay.episodes[name].places.length));
    tick.max = longest - 1;
    tick.value = 0;
    drawEpisodes();
  };
  which.addEventListener("change", show);
  show();
});
