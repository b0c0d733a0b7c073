"""Every page in a browser, at a desk and on a phone, light and dark, and printed: nothing empty, cut, too wide or faint."""

import numpy as np
import pytest
from browser import blank_shares, faults
from report_results import comparison_and_diagnosis

import isetval
from isetval.app.cli import main
from isetval.app.report import report_html
from isetval.core.toml import data_folder
from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture

MOST_BLANK = 0.4  # of a printed page: the height of a figure with its heading, which do not part
PAGES = ("comparison", "diagnosis", "curve", "darks", "flats", "mixed", "edge", "chart", "disks", "campaign", "regions", "lens")


@pytest.fixture(scope="module")
def written(tmp_path_factory, model):
    """A page of every kind by its name, as the commands write it."""
    folder = tmp_path_factory.mktemp("pages")
    lab = folder / "laboratory"
    lab.mkdir()
    plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml")
    for name in ("A_dark0", "A_flat1", "A_flat3", "A_flat5"):
        for i, frame in enumerate(isetval.simulate(model, plan.only([name]), 5).captures.read(name)):
            isetval.write_dng(lab / f"{name}_{i}.dng", frame)
    darks = folder / "darks"
    darks.mkdir()
    for path in lab.glob("A_dark0_*.dng"):
        (darks / path.name).write_bytes(path.read_bytes())
    edge = edge_capture(EdgeTruth(EdgeBlur(cutoff_cy_px=0.8), angle_deg=5.0), snr_bright=60)
    isetval.write_dng(folder / "edge.dng", edge)
    chart = next(s for s in plan.shots if s.role == "chart").name
    isetval.write_dng(folder / "chart.dng", isetval.simulate(model, plan.only([chart]), 5).captures.read(chart)[0])
    row, col = np.mgrid[:160, :200]
    light = 0.2 + 0.8 * np.all([np.hypot(row - r, col - c) > 12 for r in (30, 80, 130) for c in (30, 90, 150)], axis=0)
    codes = np.clip(np.rint(64 + 0.1 * np.random.default_rng(2).poisson(6000 * light)), 0, 1023).astype(int)
    isetval.write_dng(folder / "disks.dng", isetval.Capture.from_array(codes, time_s=0.01))
    table = folder / "fall_off.csv"
    radius = np.linspace(0.1, 3.4, 30)
    table.write_text("radius_mm,value\n" + "".join(f"{r:.3f},{1 - 0.05 * r**2:.4f}\n" for r in radius))
    curve = [
        "compare",
        "isetval:pixel4a",
        table,
        "--as",
        "relative_illumination",
        "--sigma",
        "0.003",
        "-o",
        folder / "c.json",
        "-q",
    ]
    commands = (
        ["measure", lab, "--role", "flat", "-o", folder / "flats.html", "-q"],
        ["measure", darks, "--role", "dark", "-o", folder / "darks.html", "-q"],
        ["measure", lab, "-o", folder / "mixed.html", "-q"],
        ["lens", "audit", data_folder() / "lens" / "default_lens.json", "-o", folder / "lens.html", "-q"],
        ["measure", folder / "edge.dng", "--role", "edge", "-o", folder / "edge.html", "-q"],
        ["measure", folder / "chart.dng", "-o", folder / "chart.html", "-q"],
        ["measure", folder / "disks.dng", "--role", "disk", "-o", folder / "disks.html", "-q"],
        ["roi", folder / "edge.dng", "-o", folder / "regions.html", "-q"],
        ["campaign", "init", lab, "-q"],
        [*curve, "-o", folder / "c.json"],
        ["report", folder / "c.json", "-o", folder / "curve.html", "-q"],
    )
    for command in commands:
        assert main([str(word) for word in command]) == 0
    (lab / "campaign.html").rename(folder / "campaign.html")
    return folder


@pytest.fixture(scope="module")
def pages(written, result):
    made = {"comparison": report_html([result]), "diagnosis": report_html(comparison_and_diagnosis())}
    return made | {path.stem: path.read_text(encoding="utf-8") for path in written.glob("*.html")}


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_nothing_is_empty_cut_too_wide_or_faint(pages, name, dark, tmp_path):
    assert faults(pages[name], tmp_path, widths=(1280, 390), dark=dark) == {}


@pytest.mark.parametrize("name", PAGES)
def test_a_print_leaves_no_gaps(pages, name, tmp_path):
    assert all(share < MOST_BLANK for share in blank_shares(pages[name], tmp_path))


WRONG = """<style>.card { background: #fff; } .box { width: 200px; overflow: hidden; white-space: nowrap; }</style>
<div class="card"><h3>Title</h3></div>
<div class="box">a label that is far too long for the box in which it stands</div>
<div style="width: 1500px">wide</div><p style="color: #ccc">faint</p>
<svg viewBox="0 0 100 50" width="200"><circle r="3" cx="9" cy="9"/><text x="90" y="20">cut off</text>
<text x="10" y="40">one</text><text x="12" y="41">two</text></svg>"""


def test_the_inspection_sees_what_is_wrong(tmp_path):
    found = faults(WRONG, tmp_path, widths=(800,))[800]
    for kind, words in (
        ("wide", "wide"),
        ("cut", "cut off"),
        ("cut", "a label"),
        ("empty", "Title"),
        ("over", "one"),
        ("faint", "faint"),
    ):
        assert any(words in told for told in found[kind]), kind
    tall = '<div style="height: 400px">above</div><div style="height: 900px; break-inside: avoid">below</div><p>end</p>'
    assert max(blank_shares(tall, tmp_path)) > MOST_BLANK


def test_after_a_click_on_after_nothing_is_wrong_either(pages, tmp_path):
    click = "window.addEventListener('load', function () { document.querySelector('[data-show=\"1\"]').click(); });"
    page = pages["comparison"].replace("</body>", f"<script>{click}</script></body>")
    assert faults(page, tmp_path, widths=(1280, 390)) == {}
