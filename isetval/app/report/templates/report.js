"use strict";
(function () {
  var buttons = Array.prototype.slice.call(document.querySelectorAll("[data-show]"));
  function show(index) {
    document.querySelectorAll(".layer").forEach(function (layer) {
      layer.classList.toggle("off", layer.getAttribute("data-model") !== index);
    });
    buttons.forEach(function (button) {
      button.setAttribute("aria-pressed", String(button.getAttribute("data-show") === index));
    });
    document.querySelectorAll("[data-cell]").forEach(function (cell) {
      cell.style.opacity = cell.getAttribute("data-cell") === index ? "1" : ".65";
    });
  }
  buttons.forEach(function (button, place) {
    button.addEventListener("click", function () { show(button.getAttribute("data-show")); });
    button.addEventListener("keydown", function (event) {
      var step = event.key === "ArrowRight" ? 1 : event.key === "ArrowLeft" ? -1 : 0;
      if (step) { buttons[(place + step + buttons.length) % buttons.length].focus(); }
    });
  });
  if (buttons.length) { show(buttons[0].getAttribute("data-show")); }
  function tell(mark) {
    var plot = mark.closest(".plot, .card"), words = mark.querySelector("title");
    if (!plot || !words) { return; }
    var line = plot.querySelector(".told");
    if (!line) {
      line = document.createElement("p");
      line.className = "told";
      line.setAttribute("aria-live", "polite");
      plot.appendChild(line);
    }
    line.textContent = words.textContent;
  }
  function shown(mark) { return !mark.closest(".layer.off"); }
  document.querySelectorAll("svg").forEach(function (plot) {
    var every = Array.prototype.slice.call(plot.querySelectorAll("circle[tabindex]"));
    if (!every.length) { return; }
    // one stop of the tab key a plot: the arrow keys go on from there, from left to right
    every.sort(function (a, b) { return a.getAttribute("cx") - b.getAttribute("cx"); });
    every.forEach(function (mark) {
      mark.setAttribute("tabindex", "-1");
      mark.addEventListener("focus", function () { tell(mark); });
    });
    plot.setAttribute("tabindex", "0");
    plot.addEventListener("keydown", function (event) {
      var step = event.key === "ArrowRight" ? 1 : event.key === "ArrowLeft" ? -1 : 0, marks = every.filter(shown);
      if (!step || !marks.length) { return; }
      event.preventDefault();
      var at = marks.indexOf(document.activeElement);
      marks[at < 0 ? (step > 0 ? 0 : marks.length - 1) : (at + step + marks.length) % marks.length].focus();
    });
    plot.addEventListener("click", function (event) {  // a finger is wider than a mark: the nearest one is meant
      var best = null, least = 900;
      every.filter(shown).forEach(function (mark) {
        var box = mark.getBoundingClientRect();
        var away = Math.pow(box.left + box.width / 2 - event.clientX, 2) + Math.pow(box.top + box.height / 2 - event.clientY, 2);
        if (away < least) { least = away; best = mark; }
      });
      if (best) { best.focus(); tell(best); }
    });
  });
  document.querySelectorAll("[data-download]").forEach(function (link) {
    var source = document.getElementById(link.getAttribute("data-download"));
    link.addEventListener("click", function () {
      link.href = URL.createObjectURL(new Blob([source.textContent], { type: "text/plain" }));
    });
  });
})();
