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
  document.querySelectorAll("circle[tabindex]").forEach(function (mark) {
    mark.addEventListener("focus", function () { tell(mark); });
    mark.addEventListener("click", function () { tell(mark); });
  });
  document.querySelectorAll("[data-download]").forEach(function (link) {
    var source = document.getElementById(link.getAttribute("data-download"));
    link.addEventListener("click", function () {
      link.href = URL.createObjectURL(new Blob([source.textContent], { type: "text/plain" }));
    });
  });
})();
