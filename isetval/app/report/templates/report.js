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
      cell.style.opacity = cell.getAttribute("data-cell") === index ? "1" : ".45";
    });
  }
  buttons.forEach(function (button, place) {
    button.addEventListener("click", function () { show(button.getAttribute("data-show")); });
    button.addEventListener("keydown", function (event) {
      var step = event.key === "ArrowRight" ? 1 : event.key === "ArrowLeft" ? -1 : 0;
      if (step) { buttons[(place + step + buttons.length) % buttons.length].focus(); }
    });
  });
  if (buttons.length) { show(buttons[buttons.length - 1].getAttribute("data-show")); }
  document.querySelectorAll("[data-download]").forEach(function (link) {
    var source = document.getElementById(link.getAttribute("data-download"));
    link.addEventListener("click", function () {
      link.href = URL.createObjectURL(new Blob([source.textContent], { type: "text/plain" }));
    });
  });
})();
