"""The page of regions: drawn in a headless browser by mouse and by touch, downloaded, measured."""

import html
import json
import re
import shutil
import subprocess
import tomllib

import numpy as np
import pytest

import isetval
from isetval.app.cli import main
from isetval.files.region_file import read_regions
from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture

ANGLE_DEG = 6.0
EDGE = EdgeTruth(EdgeBlur(gaussian_sigma_px=0.9), angle_deg=ANGLE_DEG)
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
DRAW = """
<script>
window.addEventListener("load", function () { setTimeout(function () {
  var view = document.getElementById("view"), box = view.getBoundingClientRect();
  function at(kind, row, col, type) {
    view.dispatchEvent(new PointerEvent(kind, { pointerId: 1, pointerType: type, isPrimary: true, bubbles: true,
      clientX: box.left + (col + 0.5) / COLS * box.width, clientY: box.top + (row + 0.5) / ROWS * box.height }));
  }
  function draw(tool, a, b, type) {
    document.querySelector("[data-tool=" + tool + "]").click();
    at("pointerdown", a[0], a[1], type); at("pointermove", b[0], b[1], type); at("pointerup", b[0], b[1], type);
  }
  draw("edge", EDGE_A, EDGE_B, "mouse");
  draw("patch", [10, 10], [39, 29], "touch");
  draw("line", [60, 20], [60, 100], "pen");
  draw("patch", [5, 5], [6, 6], "mouse");
  document.getElementById("toml").textContent = document.getElementById("toml").value;
}, 300); });
</script>
"""


@pytest.fixture(scope="module")
def picture(tmp_path_factory):
    """A DNG with one edge of known angle and blur through its middle."""
    folder = tmp_path_factory.mktemp("roi")
    capture = edge_capture(EDGE, shape=(128, 128))
    isetval.write_dng(folder / "edge.dng", capture)
    return folder / "edge.dng"


def test_the_page_stands_alone_and_a_missing_output_is_refused(picture, tmp_path, capsys):
    assert main(["roi", str(picture)]) == 3
    assert main(["roi", str(picture), "-o", str(tmp_path / "roi.html")]) == 0
    page = (tmp_path / "roi.html").read_text()
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    assert "data:image/png;base64," in page


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_regions_drawn_in_a_browser_are_measured(picture, tmp_path, capsys):
    assert main(["roi", str(picture), "-o", str(tmp_path / "roi.html")]) == 0
    rows = cols = 128
    # the edge's normal leans by ANGLE_DEG from the columns' axis: along it, columns fall by tan(angle) a row
    slope = -np.tan(np.radians(ANGLE_DEG))
    ends = [[row, float(63.5 + slope * (row - 63.5))] for row in (20, 107)]
    script = DRAW.replace("ROWS", str(rows)).replace("COLS", str(cols))
    script = script.replace("EDGE_A", str(ends[0])).replace("EDGE_B", str(ends[1]))
    page = (tmp_path / "roi.html").read_text().replace("</body>", script + "</body>")
    (tmp_path / "drawn.html").write_text(page)
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--window-size=1280,900", "--virtual-time-budget=3000"]
    done = subprocess.run([*command, "--dump-dom", f"file://{tmp_path}/drawn.html"], capture_output=True, text=True, timeout=120)
    words = html.unescape(re.search(r'<textarea id="toml".*?>(.*?)</textarea>', done.stdout, re.S)[1])
    (tmp_path / "regions.toml").write_text(words)
    table = tomllib.loads(words)
    edge = table["target"]["edge_1"]
    assert edge["orientation"] == "vertical"
    assert edge["angle_deg"] == pytest.approx(-ANGLE_DEG, abs=0.1)
    assert edge["dark_side"] == "low"
    drawn = read_regions(tmp_path / "regions.toml")
    assert drawn.patches == (("patch_1", (10, 40, 10, 30)),)  # a slip of a pixel is no patch
    assert drawn.lines[0][0] == "line_1"
    assert np.allclose(drawn.lines[0][1:], [(60, 20), (60, 100)], atol=0.2)  # tenths of a pixel are written
    assert main(["measure", str(picture), "--regions", str(tmp_path / "regions.toml"), "-o", str(tmp_path / "m.json")]) == 0
    rows_ = {(r["name"], r["region"]): r for r in json.loads((tmp_path / "m.json").read_text())["metrics"]}
    found = rows_["mtf50", "edge_1"]
    truth = EDGE.mtf50_cy_px()  # integrated, with the pixel's aperture
    assert found["value"] == pytest.approx(truth, rel=2e-3)  # no noise: codes are whole numbers, 1 of 6000
    assert {("patch_mean", "patch_1"), ("line_mean", "line_1")} <= set(rows_)


def test_a_file_without_regions_or_with_bad_ones_is_refused(picture, tmp_path, capsys):
    for text, words in (
        ("x = 1\n", "holds no region"),
        ('[[line]]\nname = "a"\nfrom = [1, 2]\n', "to"),
        ('[target.a]\nkind = "chart"\npatch = [{ name = "p", box = [9, 3, 0, 4] }]\n', "row0 < row1"),
    ):
        (tmp_path / "r.toml").write_text(text)
        assert main(["measure", str(picture), "--regions", str(tmp_path / "r.toml")]) == 3
        assert words in capsys.readouterr().err
