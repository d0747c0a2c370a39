"use strict";
// An interim report is read again until the run is over, but not under its reader's hands.
document.addEventListener("DOMContentLoaded", () => {
  const seconds = Number(document.getElementById("interim").dataset.seconds);
  const QUIET = 10000; // milliseconds after the last key, click or turn of the wheel
  let touched = -QUIET;
  if (!seconds) return;
  for (const event of ["pointerdown", "keydown", "wheel", "touchmove"]) {
    addEventListener(event, () => { touched = performance.now(); }, { passive: true });
  }
  const timer = setInterval(() => {
    if (document.hidden || performance.now() - touched < QUIET) return;
    clearInterval(timer); // a second reload would break off a first that takes long
    location.reload();
  }, 1000 * seconds);
});
