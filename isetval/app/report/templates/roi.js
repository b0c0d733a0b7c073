"use strict";
(function () {
  var facts = JSON.parse(document.getElementById("facts").textContent);
  var canvas = document.getElementById("view"), out = document.getElementById("toml"), list = document.getElementById("list");
  var image = new Image(), draw = canvas.getContext("2d"), luma = null;
  var marks = [], tool = "edge", start = null, now = null, zoom = 1;
  var colors = { edge: "#12a150", patch: "#f5a524", line: "#3b82f6" };

  function px(value) { return Math.round(value * 10) / 10; }
  function place(event) {  // capture pixels under the pointer; a pixel's center has whole numbers
    var box = canvas.getBoundingClientRect();
    var col = (event.clientX - box.left) / box.width * facts.cols - 0.5, row = (event.clientY - box.top) / box.height * facts.rows - 0.5;
    return { row: Math.min(Math.max(row, 0), facts.rows - 1), col: Math.min(Math.max(col, 0), facts.cols - 1) };
  }
  function box(mark) {
    var pad = mark.kind === "edge" ? Number(document.getElementById("width").value) / 2 : 0;
    var wide = mark.kind === "edge" && Math.abs(mark.b.row - mark.a.row) >= Math.abs(mark.b.col - mark.a.col);
    var row = wide ? 0 : pad, col = wide ? pad : 0;
    return [
      Math.max(0, Math.round(Math.min(mark.a.row, mark.b.row) - row)), Math.min(facts.rows, Math.round(Math.max(mark.a.row, mark.b.row) + row) + 1),
      Math.max(0, Math.round(Math.min(mark.a.col, mark.b.col) - col)), Math.min(facts.cols, Math.round(Math.max(mark.a.col, mark.b.col) + col) + 1)
    ];
  }
  function mean(mark, side) {  // of the picture beside an edge, on one side of it
    var dr = mark.b.row - mark.a.row, dc = mark.b.col - mark.a.col, length = Math.hypot(dr, dc) || 1, sum = 0, count = 0;
    var across = Number(document.getElementById("width").value) / 4;
    for (var t = 0.2; t <= 0.8; t += 0.05) {
      var vertical = Math.abs(dr) >= Math.abs(dc);
      var row = mark.a.row + t * dr + (vertical ? 0 : side * across), col = mark.a.col + t * dc + (vertical ? side * across : 0);
      var x = Math.round((col + 0.5) / facts.cols * image.width), y = Math.round((row + 0.5) / facts.rows * image.height);
      if (luma && x >= 0 && y >= 0 && x < image.width && y < image.height) { sum += luma[4 * (y * image.width + x)]; count += 1; }
    }
    return count && length ? sum / count : 0;
  }
  function edge(mark) {
    var dr = mark.b.row - mark.a.row, dc = mark.b.col - mark.a.col, vertical = Math.abs(dr) >= Math.abs(dc), b = box(mark);
    // from the column axis (vertical) or the row axis (horizontal): columns per row, rows per column
    var angle = Math.atan(vertical ? dc / (dr || 1e-9) : dr / (dc || 1e-9)) * 180 / Math.PI;
    var middle = [(facts.rows - 1) / 2, (facts.cols - 1) / 2];
    var offset = [px((mark.a.row + mark.b.row) / 2 - middle[0]), px((mark.a.col + mark.b.col) / 2 - middle[1])];
    return [
      "[target." + mark.name + "]", 'kind = "edge"', 'orientation = "' + (vertical ? "vertical" : "horizontal") + '"',
      "angle_deg = " + angle.toFixed(2) + "  # as drawn; sfr finds its own", "offset_px = [" + offset.map(function (v) { return v.toFixed(1); }).join(", ") + "]",
      'dark_side = "' + (mean(mark, -1) <= mean(mark, 1) ? "low" : "high") + '"',
      "dark_reflectance = 0.05  # CHECK", "bright_reflectance = 0.8  # CHECK", "roi = [" + b.join(", ") + "]", ""
    ];
  }
  function text() {
    var lines = ["# Regions of " + facts.name + ", rows and columns from 0, half open; drawn with isetval roi", ""];
    marks.filter(function (m) { return m.kind === "edge"; }).forEach(function (m) { lines = lines.concat(edge(m)); });
    var patches = marks.filter(function (m) { return m.kind === "patch"; });
    if (patches.length) {
      lines.push("[target.patches]", 'kind = "chart"', "patch = [");
      patches.forEach(function (m) { lines.push('  { name = "' + m.name + '", box = [' + box(m).join(", ") + "] },"); });
      lines.push("]", "");
    }
    marks.filter(function (m) { return m.kind === "line"; }).forEach(function (m) {
      lines.push("[[line]]", 'name = "' + m.name + '"', "from = [" + px(m.a.row).toFixed(1) + ", " + px(m.a.col).toFixed(1) + "]",
        "to = [" + px(m.b.row).toFixed(1) + ", " + px(m.b.col).toFixed(1) + "]", "");
    });
    return lines.join("\n");
  }
  function outline(mark) {
    var sx = canvas.width / facts.cols, sy = canvas.height / facts.rows, b = box(mark);
    draw.strokeStyle = draw.fillStyle = colors[mark.kind];
    draw.lineWidth = 2;
    if (mark.kind !== "line") { draw.strokeRect(b[2] * sx, b[0] * sy, (b[3] - b[2]) * sx, (b[1] - b[0]) * sy); }
    if (mark.kind !== "patch") {
      draw.beginPath();
      draw.moveTo((mark.a.col + 0.5) * sx, (mark.a.row + 0.5) * sy);
      draw.lineTo((mark.b.col + 0.5) * sx, (mark.b.row + 0.5) * sy);
      draw.stroke();
    }
    if (mark.name) { draw.font = "14px system-ui, sans-serif"; draw.fillText(mark.name, b[2] * sx + 3, Math.max(13, b[0] * sy - 4)); }
  }
  function paint() {
    draw.imageSmoothingEnabled = canvas.width < 2 * image.width;
    draw.drawImage(image, 0, 0, canvas.width, canvas.height);
    marks.forEach(outline);
    if (start && now) { outline({ kind: tool, a: start, b: now, name: "" }); }
  }
  function show() {
    paint();
    out.value = text();
    list.textContent = "";
    marks.forEach(function (mark, i) {
      var item = document.createElement("li"), name = document.createElement("input"), gone = document.createElement("button");
      name.value = mark.name;
      name.setAttribute("aria-label", "name of " + mark.name);
      name.addEventListener("change", function () { mark.name = name.value.replace(/[^A-Za-z0-9_-]/g, "_") || mark.name; show(); });
      gone.type = "button";
      gone.textContent = "remove";
      gone.addEventListener("click", function () { marks.splice(i, 1); show(); });
      item.append(mark.kind + " ", name, " ", gone);
      list.appendChild(item);
    });
  }
  function resize() {
    canvas.style.width = 100 * zoom + "%";
    canvas.width = Math.min(4096, Math.round(canvas.clientWidth * (window.devicePixelRatio || 1)));  // what browsers hold
    canvas.height = Math.round(canvas.width * facts.rows / facts.cols);
    paint();
  }
  function free(kind) {
    var n = 1;
    while (marks.some(function (m) { return m.name === kind + "_" + n; })) { n += 1; }
    return kind + "_" + n;
  }
  canvas.addEventListener("pointerdown", function (event) {
    event.preventDefault();
    try { canvas.setPointerCapture(event.pointerId); } catch (error) { /* a pointer that is gone already */ }
    start = now = place(event);
  });
  canvas.addEventListener("pointermove", function (event) { if (start) { now = place(event); paint(); } });
  canvas.addEventListener("pointercancel", function () { start = now = null; paint(); });
  canvas.addEventListener("pointerup", function (event) {
    if (!start) { return; }
    var end = place(event);
    if (Math.hypot(end.row - start.row, end.col - start.col) >= 4) { marks.push({ kind: tool, a: start, b: end, name: free(tool) }); }
    start = now = null;
    show();
  });
  document.querySelectorAll("[data-tool]").forEach(function (button) {
    button.addEventListener("click", function () {
      tool = button.getAttribute("data-tool");
      document.querySelectorAll("[data-tool]").forEach(function (other) { other.setAttribute("aria-pressed", String(other === button)); });
    });
  });
  document.querySelectorAll("[data-zoom]").forEach(function (button) {
    button.addEventListener("click", function () { zoom = Number(button.getAttribute("data-zoom")); resize(); });
  });
  document.getElementById("width").addEventListener("change", show);
  document.getElementById("save").addEventListener("click", function () {
    this.href = URL.createObjectURL(new Blob([text()], { type: "text/plain" }));
  });
  window.addEventListener("resize", resize);
  image.addEventListener("load", function () {
    var copy = document.createElement("canvas");
    copy.width = image.width;
    copy.height = image.height;
    copy.getContext("2d").drawImage(image, 0, 0);
    luma = copy.getContext("2d").getImageData(0, 0, image.width, image.height).data;
    resize();
    show();
  });
  image.src = document.getElementById("source").getAttribute("href");
})();
