"use strict";
document.addEventListener("DOMContentLoaded", () => {
  const nonce = document.querySelector("script").nonce;
  const at = (id) => document.getElementById(id);
  const report = at("report"), SVG = "http://www.w3.org/2000/svg";
  const QUIET = 3000; // milliseconds after the last key or click in which nothing is replaced
  let from = null, rows = 0, page = 0, pending = null, began = false, touched = 0, over = false;

  const say = (id, words) => { at(id).textContent = words; at(id).hidden = !words; };
  const made = (tag, words, parent) => {
    const found = document.createElement(tag);
    if (words) found.textContent = words;
    parent?.append(found);
    return found;
  };

  // -- rows -----------------------------------------------------------------------------------

  const drawn = (curve) => {
    const svg = document.createElementNS(SVG, "svg");
    svg.setAttribute("class", "curve");
    svg.setAttribute("viewBox", "0 -2 140 48");
    svg.setAttribute("aria-hidden", "true");
    for (const [tag, points] of [["polygon", curve?.band], ["polyline", curve?.line]]) {
      if (!points) continue;
      const part = document.createElementNS(SVG, tag);
      part.setAttribute("points", points);
      svg.append(part);
    }
    return svg;
  };
  const showRows = (all) => at("rows").replaceChildren(...all.map((one) => {
    const item = made("li");
    item.append(drawn(one.curve));
    const words = made("div", "", item);
    made("p", one.name, words);
    const bar = made("progress", "", words);
    bar.max = one.seeds;
    bar.value = one.stored;
    bar.setAttribute("aria-label", `Seeds of ${one.name}`);
    const ends = one.words && `; return ${one.words}`;
    made("p", `${one.stored} of ${one.seeds} seed${one.seeds === 1 ? "" : "s"}${ends}`, words).className = "small";
    return item;
  }));

  // -- the report -----------------------------------------------------------------------------

  // What a reader has changed: it is the same after the report was replaced.
  const kept = () => {
    const sections = [...report.querySelectorAll("section[id]")];
    const first = sections.find((one) => one.getBoundingClientRect().bottom > at("now").offsetHeight);
    return {
      open: [...report.querySelectorAll("details")].map((one) => one.open),
      aside: [...report.querySelectorAll(".across")].map((one) => one.scrollLeft),
      chosen: [...report.querySelectorAll("input[id], select[id]")].map((one) => [one.id, one.checked, one.value]),
      focus: report.contains(document.activeElement) ? document.activeElement.id : "",
      place: window.scrollY > 0 && first ? [first.id, first.getBoundingClientRect().top] : null,
    };
  };
  const restore = (before) => {
    report.querySelectorAll("details").forEach((one, i) => { one.open = before.open[i] ?? one.open; });
    report.querySelectorAll(".across").forEach((one, i) => { one.scrollLeft = before.aside[i] ?? 0; });
    for (const [id, checked, value] of before.chosen) {
      const one = at(id);
      if (!one || (one.checked === checked && one.value === value)) continue;
      const now = one.value;
      one.checked = checked;
      one.value = value;
      if (one.value !== value) one.value = now; // it is no longer among the choices
      for (const event of ["input", "change"]) one.dispatchEvent(new Event(event, { bubbles: true }));
    }
    if (before.focus) at(before.focus)?.focus({ preventScroll: true });
    const first = before.place && at(before.place[0]);
    if (first) window.scrollBy({ top: first.getBoundingClientRect().top - before.place[1], behavior: "instant" });
  };
  const replace = (text) => {
    const found = new DOMParser().parseFromString(text, "text/html"), before = kept();
    found.querySelector("body > footer")?.remove(); // it says that the page requests nothing
    report.replaceChildren(...found.body.childNodes);
    if (!began) {
      for (const one of found.head.querySelectorAll("style, script")) {
        const own = made(one.localName);
        if (one.localName === "script") own.nonce = nonce;
        own.textContent = one.textContent;
        document.head.append(own);
      }
      at("name").hidden = true;
      at("keep").hidden = false;
      at("tasks").open = false;
      began = true;
    }
    // The report's own scripts begin when a document is loaded: they do so with each of its contents.
    document.dispatchEvent(new Event("DOMContentLoaded"));
    restore(before);
  };
  const show = () => {
    if (pending === null || at("held").checked || performance.now() - touched < QUIET) return;
    const text = pending;
    pending = null;
    replace(text);
  };
  for (const event of ["pointerdown", "keydown", "input"]) {
    report.addEventListener(event, (each) => { if (each.isTrusted) touched = performance.now(); });
  }
  at("held").addEventListener("change", show);
  setInterval(show, 500);

  // -- the stream -----------------------------------------------------------------------------

  const fetched = async (path) => {
    const answer = await fetch(path);
    if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
    return answer;
  };
  const take = async (state) => {
    if (state.rows !== rows) {
      showRows(await (await fetched("/rows")).json());
      rows = state.rows;
    }
    if (state.page !== page) {
      pending = await (await fetched("/report")).text();
      page = state.page;
      show();
    }
  };
  let taking = false;
  const events = new EventSource("/events");
  events.addEventListener("message", async (message) => {
    const state = JSON.parse(message.data);
    if (from !== null && state.of !== from) { location.reload(); return; }
    from = state.of;
    const share = state.units ? state.stored / state.units : 0;
    at("share").value = share;
    say("line", state.line || "Waiting for the run …");
    say("note", state.ended && began ? "" : state.note);
    say("trouble", state.trouble);
    if (!began) at("name").textContent = state.name;
    const ended = state.ended || state.standing; // after the latter it may go on
    const finished = state.ended || (ended && share === 1);
    document.title = `${finished ? "Ended" : `${Math.floor(100 * share)} %`} · ${state.name}`;
    if (taking || over) return;
    taking = true;
    try {
      await take(state);
      at("ended").className = "";
      say("ended", ended);
      over = Boolean(state.ended);
      if (over) events.close();
      if (over && !at("held").checked) at("keep").hidden = true;
    } catch { /* the stream's next message tries again, or its error says what is wrong */ } finally {
      taking = false;
    }
  });
  events.addEventListener("error", () => {
    if (over || at("ended").className === "lost") return;
    at("ended").className = "lost";
    const time = new Date().toLocaleTimeString();
    say("ended", `Nothing answers since ${time}: the run has stopped, or the command that shows it. This is the last that it sent.`);
  });
}, { once: true });
