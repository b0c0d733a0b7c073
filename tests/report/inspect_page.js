"use strict";
// What of the page in a frame is too wide, cut, empty, written over, or faint.
function inspected(frame) {
  var doc = frame.contentDocument, win = frame.contentWindow, out = { wide: [], cut: [], empty: [], over: [], faint: [] };
  function name(el) { return el.tagName.toLowerCase() + "." + (el.getAttribute("class") || "") + ": " + (el.textContent || "").trim().slice(0, 50); }
  function all(query, root) { return Array.prototype.slice.call((root || doc).querySelectorAll(query)); }
  function seen(el) { var b = el.getBoundingClientRect(); return b.width > 0 && b.height > 0; }
  function scrolls(el) {
    for (var e = el.parentElement; e; e = e.parentElement) {
      if (/(auto|scroll|hidden)/.test(win.getComputedStyle(e).overflowX)) { return true; }
    }
    return false;
  }
  if (doc.documentElement.scrollWidth > win.innerWidth) { out.wide.push("page " + doc.documentElement.scrollWidth + " > " + win.innerWidth); }
  all("body *").filter(seen).forEach(function (el) {
    if (el.getBoundingClientRect().right > win.innerWidth + 1 && !scrolls(el)) { out.wide.push(name(el)); }
    var style = win.getComputedStyle(el);
    if (style.overflowX === "hidden" && el.scrollWidth > el.clientWidth + 1 && el.textContent.trim()) { out.cut.push(name(el)); }
  });
  function shade(color) {  // relative luminance, WCAG 2.2
    var parts = color.match(/[\d.]+/g).map(Number), c = parts.slice(0, 3).map(function (v) {
      v /= 255;
      return v <= 0.04045 ? v / 12.92 : Math.pow((v + 0.055) / 1.055, 2.4);
    });
    return { y: 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2], alpha: parts.length > 3 ? parts[3] : 1 };
  }
  function behind(el) {
    for (var e = el; e; e = e.parentElement) {
      var back = shade(win.getComputedStyle(e).backgroundColor);
      if (back.alpha > 0.5) { return back.y; }
    }
    return 1;
  }
  all("body *").filter(seen).forEach(function (el) {
    var own = Array.prototype.some.call(el.childNodes, function (n) { return n.nodeType === 3 && n.textContent.trim(); });
    if (!own) { return; }
    var style = win.getComputedStyle(el), ink = shade(el.closest("svg") ? style.fill : style.color).y, paper = behind(el);
    if ((Math.max(ink, paper) + 0.05) / (Math.min(ink, paper) + 0.05) < 4.5) { out.faint.push(name(el)); }
  });
  all("svg").filter(seen).forEach(function (svg) {
    var area = svg.getBoundingClientRect(), texts = all("text", svg).filter(seen);
    var boxes = texts.map(function (t) { return t.getBoundingClientRect(); });
    texts.forEach(function (text, i) {
      var box = boxes[i];
      if (box.left < area.left - 1 || box.right > area.right + 1 || box.top < area.top - 1 || box.bottom > area.bottom + 1) { out.cut.push(name(text)); }
      boxes.slice(i + 1).forEach(function (other, j) {
        var x = Math.min(box.right, other.right) - Math.max(box.left, other.left), y = Math.min(box.bottom, other.bottom) - Math.max(box.top, other.top);
        if (x > 2 && y > 4) { out.over.push(name(text) + " | " + name(texts[i + 1 + j])); }
      });
    });
    var marks = all("image, circle, polyline, polygon, path, rect, line", svg).filter(function (m) { return !/grid|axis|tick|one|band/.test(m.getAttribute("class") || "") && seen(m) | m.tagName === "path"; });
    if (!marks.length) { out.empty.push(name(svg)); }
  });
  all(".card, .plot, .pair, .sheet, section, figure").forEach(function (card) {
    if (seen(card) && !card.textContent.trim() && !card.querySelector("img, svg, canvas")) { out.empty.push(name(card)); }
  });
  all(".card, .plot").filter(seen).forEach(function (card) {
    var heading = card.querySelector("h3, b"), said = card.textContent.replace(heading ? heading.textContent : "", "").trim();
    if (!said && !card.querySelector("img, svg, table")) { out.empty.push(name(card)); }
  });
  all("tbody").filter(seen).forEach(function (body) { if (!body.textContent.trim()) { out.empty.push(name(body)); } });
  all("h2").forEach(function (h) {
    var next = h.nextElementSibling;
    if (!next || next.tagName === "H2") { out.empty.push(name(h)); }
  });
  all("img").forEach(function (img) { if (!img.naturalWidth) { out.empty.push("img " + img.alt); } });
  return out;
}
