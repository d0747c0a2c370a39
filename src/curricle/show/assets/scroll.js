"use strict";
// What is wider than the page says that it scrolls.
document.addEventListener("DOMContentLoaded", () => {
  const wide = new ResizeObserver((entries) => entries.forEach(({ target }) => {
    target.classList.toggle("scrolls", target.scrollWidth > target.clientWidth + 1);
  }));
  document.querySelectorAll(".across").forEach((item) => wide.observe(item));
});
