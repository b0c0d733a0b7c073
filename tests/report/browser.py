"""A page in headless Chromium: what of it is empty, cut or too wide, and how much paper its print leaves blank."""

import html
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

CHROMIUM = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)
PDFTOPPM = shutil.which("pdftoppm")
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu")

INSPECT = (Path(__file__).parent / "inspect_page.js").read_text(encoding="utf-8")


def faults(page, folder, *, widths=(1280,), dark=False):
    """What is wrong with a page of text, by width: ``wide``, ``cut``, ``empty``, ``over`` (labels on labels), ``faint``
    (text of less contrast than 4.5, WCAG 2.2 level AA); nothing for a width at which nothing is.

    The page is laid out in frames: the windows of headless Chromium are never narrower than 500 pixels.
    """
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine")
    style = "border:0;display:block;height:900px;width:"
    frames = "".join(f'<iframe style="{style}{width}px" srcdoc="{html.escape(page)}"></iframe>' for width in widths)
    told = "document.title = JSON.stringify(Array.prototype.map.call(document.querySelectorAll('iframe'), inspected));"
    script = f'<script>{INSPECT}\nwindow.addEventListener("load", function () {{ {told} }});</script>'
    path = folder / "frames.html"
    path.write_text(f'<!doctype html><meta charset="utf-8"><body style="margin:0">{frames}{script}', encoding="utf-8")
    mode = ["--blink-settings=preferredColorScheme=0"] if dark else []
    size = f"--window-size={max(*widths, 500)},900"
    command = [CHROMIUM, *FLAGS, *mode, f"--user-data-dir={folder / 'profile'}", size, "--dump-dom"]
    done = subprocess.run([*command, path.as_uri()], capture_output=True, text=True, timeout=180, check=False)
    title = done.stdout.partition("<title>")[2].partition("</title>")[0]
    if not title:
        pytest.skip("Chromium does not start on this machine")
    seen = json.loads(html.unescape(title))
    return {width: wrong for width, one in zip(widths, seen, strict=True) if (wrong := {k: v for k, v in one.items() if v})}


def blank_shares(page, folder):
    """Share of each printed page but the last that is white below its last mark, (pages - 1,)."""
    if CHROMIUM is None or PDFTOPPM is None:
        pytest.skip("no Chromium, or no pdftoppm, on this machine")
    (folder / "print.html").write_text(page, encoding="utf-8")
    pdf = folder / "print.pdf"
    command = [CHROMIUM, *FLAGS, f"--user-data-dir={folder / 'profile'}", "--no-pdf-header-footer", f"--print-to-pdf={pdf}"]
    subprocess.run([*command, (folder / "print.html").as_uri()], capture_output=True, timeout=180, check=False)
    if not pdf.is_file():
        pytest.skip("Chromium does not print on this machine")
    subprocess.run([PDFTOPPM, "-r", "24", "-gray", str(pdf), str(folder / "print")], check=True, timeout=120)
    shares = []
    for file in sorted(folder.glob("print-*.pgm")):
        dark = np.flatnonzero((_read_pgm(file) < 200).any(axis=1))
        rows = _read_pgm(file).shape[0]
        shares.append(1.0 if not dark.size else 1 - (dark[-1] + 1) / rows)
    return shares[:-1]


def _read_pgm(file):
    kind, size, top, pixels = file.read_bytes().split(b"\n", 3)
    assert (kind, top) == (b"P5", b"255")
    cols, rows = map(int, size.split())
    return np.frombuffer(pixels, np.uint8, rows * cols).reshape(rows, cols)
