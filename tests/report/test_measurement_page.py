"""A measurement as a page, as pictures, with its curves; the numbers people ask for come first."""

import base64
import json
import re
import shutil
import subprocess

import numpy as np
import pytest

import isetval
from isetval.app.cli import main
from isetval.app.headline import headline_tables
from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture

GAIN, READ_E, BLACK = 0.25, 4.0, 64


ANGLE_DEG = 5.0


def _planted(f):
    """MTF of a circular aperture with its cut-off at 0.8 cycles/px and of a square pixel, along the edge's normal."""
    s = np.clip(f / 0.8, 0, 1)
    along, across = np.cos(np.radians(ANGLE_DEG)), np.sin(np.radians(ANGLE_DEG))
    return 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s**2)) * np.sinc(f * along) * np.sinc(f * across)


@pytest.fixture(scope="module")
def flats(tmp_path_factory):
    """A photon-transfer series of known gain: six exposure times of a steady light, two frames each, and two darks."""
    folder = tmp_path_factory.mktemp("series")
    rng = np.random.default_rng(8)
    for i, time_s in enumerate((0.001, 0.01, 0.02, 0.04, 0.08, 0.12)):
        for frame in range(2):
            electrons = rng.poisson(20000 * time_s, (64, 64)) + READ_E * rng.standard_normal((64, 64))
            codes = np.clip(np.rint(BLACK + GAIN * electrons), 0, 1023).astype(int)
            isetval.write_dng(folder / f"flat{i}_{frame}.dng", isetval.Capture.from_array(codes, time_s=time_s, iso=100))
    return folder


@pytest.fixture(scope="module")
def edge(tmp_path_factory):
    file = tmp_path_factory.mktemp("edge") / "edge.dng"
    isetval.write_dng(file, edge_capture(EdgeTruth(EdgeBlur(cutoff_cy_px=0.8), angle_deg=ANGLE_DEG), snr_bright=60))
    return file


def _numbers(cell):
    value, sigma = re.match(r"(-?[\d.]+) (?:±|\+-) ([\d.]+)", cell).groups()
    return float(value), float(sigma)


def test_a_series_is_a_page_with_its_gain_first_and_its_curves(flats, tmp_path, capsys):
    page = tmp_path / "flats.html"
    assert main(["measure", str(flats), "--role", "flat", "-o", str(page)]) == 0
    said = capsys.readouterr().out
    assert said.index("conversion gain") < said.index("family")
    text = page.read_text()
    assert text.index("conversion gain") < text.index("photon transfer</h2>")
    gain, sigma = _numbers(re.search(r"overall system gain \(K\)</td><td>([^<]*)", text).group(1))
    assert abs(gain - GAIN) < 4 * sigma
    pictures = [base64.b64decode(p) for p in re.findall(r"data:image/svg\+xml;base64,([^\"]*)", text)]
    assert len(pictures) >= 1
    assert all(b"<svg" in p for p in pictures)
    assert not re.findall(r"(?:src|href)=\"(?:https?:)?//", text)
    result = json.loads(re.search(r'id="data-json">(.*?)</script>', text, re.S).group(1))
    levels = next(c["photon_transfer"] for c in result["curves"].values() if "photon_transfer" in c)["R"]
    # the planted line: variance = K^2 read^2 + 1/12 + K mean, five sigma
    for level in levels:
        expected = GAIN**2 * READ_E**2 + 1 / 12 + GAIN * level["mean_dn"]
        assert abs(level["variance_dn2"] - expected) < 5 * max(level["variance_sigma_dn2"], 0.01 * expected)


def test_an_edge_shows_both_mtf50_and_its_sfr(edge, tmp_path):
    page = tmp_path / "edge.html"
    assert main(["measure", str(edge), "--role", "edge", "-o", str(page), "-q"]) == 0
    text = page.read_text()
    assert "iso12233:2023" in text
    result = json.loads(re.search(r'id="data-json">(.*?)</script>', text, re.S).group(1))
    (curve,) = next(c["edges"] for c in result["curves"].values() if "edges" in c)
    f, mtf, sigma = (np.array(curve[k]) for k in ("frequency_cy_px", "mtf", "mtf_sigma"))
    inside = (f > 0.05) & (f < 0.5)
    # the planted curve, within five of its sigmas and the 1 % that the estimator's smoothing may cost
    assert np.all(np.abs(mtf - _planted(f))[inside] < 5 * sigma[inside] + 0.01)


@pytest.mark.parametrize(("suffix", "begins"), [(".png", b"\x89PNG"), (".pdf", b"%PDF")])
def test_figures_as_files(edge, tmp_path, suffix, begins):
    assert main(["measure", str(edge), "--role", "edge", "-o", str(tmp_path / f"e{suffix}"), "-q"]) == 0
    assert (tmp_path / f"e{suffix}").read_bytes().startswith(begins)


def test_curves_in_the_json_without_a_page(edge, tmp_path):
    assert main(["measure", str(edge), "--role", "edge", "--curves", "-o", str(tmp_path / "e.json"), "-q"]) == 0
    assert json.loads((tmp_path / "e.json").read_text())["curves"]
    assert main(["measure", str(edge), "--role", "edge", "-o", str(tmp_path / "plain.json"), "-q"]) == 0
    assert "curves" not in json.loads((tmp_path / "plain.json").read_text())


def test_one_dark_shows_its_codes_and_lines(tmp_path):
    rng = np.random.default_rng(3)
    codes = np.rint(64 + 2 * rng.standard_normal((96, 96))).astype(int)
    codes[40] += 8
    capture = isetval.Capture.from_array(codes, time_s=0.01)
    count = isetval.plots.plot_dark_codes(capture).lines
    assert sum(line.get_ydata().sum() for line in count) == codes.size
    rows, columns = isetval.plots.plot_dark_lines(capture).lines
    assert int(np.argmax(rows.get_ydata())) == 40
    assert np.ptp(columns.get_ydata()) < 8 * 2 / np.sqrt(96)
    isetval.write_dng(tmp_path / "d.dng", capture)
    assert main(["measure", str(tmp_path / "d.dng"), "--role", "dark", "-o", str(tmp_path / "d.html"), "-q"]) == 0
    assert "dark frames</h2>" in (tmp_path / "d.html").read_text()


def _mtf50(value, x_mm, shot, channel="G"):
    row = {"name": "mtf50", "family": "summary_mtf50", "value": value, "sigma": 0.01, "unit": "cy/px"}
    return row | {"channel": channel, "field_x_mm": x_mm, "field_y_mm": 0.0, "shot": shot}


def test_sharpness_is_told_by_place_and_by_extremes():
    rows = [_mtf50(0.3, 0.1, "a"), _mtf50(0.2, 2.0, "b"), _mtf50(0.25, 1.0, "c"), _mtf50(0.9, 0.0, "red", "R")]
    ((title, table),) = headline_tables(rows)
    assert title == "sharpness, channel G, 3 edges"
    found = {line[0]: (line[1].split()[0], line[2].split()[-1]) for line in table[1:]}
    assert found == {
        "nearest the center": ("0.300", "a"),
        "part way": ("0.250", "c"),
        "farthest out": ("0.200", "b"),
        "sharpest": ("0.300", "a"),
        "least sharp": ("0.200", "b"),
    }


def test_of_many_full_frames_the_one_that_tells_the_fall_off_best_is_quoted():
    def row(shot, sigma, region="r 3.0 mm"):
        row = {"name": "relative_illumination", "value": 0.5, "sigma": sigma, "unit": "1", "channel": "G", "shot": shot}
        return row | {"measurement_session": "A", "region": region}

    rows = [row("f1", 0.02), row("f2", 0.01), row("f3", 0.03), row("f2", 0.01, "r 1.0 mm")]
    ((title, table),) = headline_tables(rows)
    assert title == "relative illumination, f2"
    assert table == [("", "G"), ("at 3.0 mm", "0.500 +- 0.010")]


def test_places_are_said_once_and_with_the_file_and_the_unit_that_are_known():
    about_the_middle = [_mtf50(0.3, 0.10, "a"), _mtf50(0.2, 0.11, "b")]
    ((_, table),) = headline_tables(about_the_middle, half_diagonal_mm=1.0)
    # .7 of .11 mm is nearest to the first: no edge lies part way
    assert [line[0] for line in table[1:]] == ["nearest the center", "farthest out", "sharpest", "least sharp"]
    assert [line[2] for line in table[1:3]] == ["10 % of the half diagonal, a", "11 % of the half diagonal, b"]
    files = [row | {"file": f"x/{row['shot']}.dng", "region": "1,2,3,4"} for row in about_the_middle]
    ((_, named),) = headline_tables(files)
    assert named[-1][2] == "b.dng 1,2,3,4"
    fall = {"name": "relative_illumination", "value": 0.5, "sigma": 0.01, "unit": "1", "channel": "G", "region": "r 0.901 mm"}
    unknown, known = {"warnings": [{"code": "no_pixel_pitch"}]}, {"warnings": []}
    for about, words in ((unknown, "at 901 px"), (known, "at 0.901 mm")):
        ((_, table),) = headline_tables([fall], files={"a.dng": about})
        assert table[1][0] == words
    ((_, table),) = headline_tables([fall], half_diagonal_mm=1.0)
    assert table[1][0] == "at 0.901 mm, 90 % of the half diagonal"


def test_edges_of_a_file_lie_where_their_regions_are():
    regions = {"0,20,0,20": 0.3, "40,60,40,60": 0.2, "10,30,40,60": 0.25}
    rows = [_mtf50(value, 0.0, "s") | {"region": region, "file": "a.dng"} for region, value in regions.items()]
    ((_, table),) = headline_tables(rows, files={"a.dng": {"shape": [100, 100]}})
    found = {line[0]: line[2] for line in table[1:]}
    # half diagonal of 100 x 100 px: 70.7 px; the region about (10, 10) lies 56.6 px from the middle, its neighbour's 0
    assert found["nearest the center"] == "0 % of the half diagonal, 40,60,40,60"
    assert found["farthest out"] == "80 % of the half diagonal, 0,20,0,20"


def test_the_page_fits_a_phone_and_a_desk(flats, tmp_path):
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        pytest.skip("no Chromium on this machine")
    page = tmp_path / "flats.html"
    assert main(["measure", str(flats), "--role", "flat", "-o", str(page), "-q"]) == 0
    probe = "<script>document.title = document.documentElement.scrollWidth + '/' + window.innerWidth</script></body>"
    page.write_text(page.read_text().replace("</body>", probe))
    for width in (1280, 500):  # headless Chromium is never narrower than 500
        command = [chromium, "--headless", "--no-sandbox", "--disable-gpu", f"--window-size={width},900", "--dump-dom", str(page)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
        scroll, inner = map(int, re.search(r"<title>(\d+)/(\d+)</title>", done.stdout).groups())
        assert scroll <= inner, width


def test_printed_disks_are_drawn_with_what_was_found(tmp_path):
    rng = np.random.default_rng(2)
    row, col = np.mgrid[:160, :200]
    light = np.ones((160, 200))
    centers = [(30 + 50 * i, 30 + 60 * j) for i in range(3) for j in range(3)]
    for r, c in centers:
        light -= 0.8 / (1 + np.exp((np.hypot(row - r, col - c) - 12) / 0.7))
    codes = np.clip(np.rint(64 + 0.1 * rng.poisson(6000 * light)), 0, 1023).astype(int)
    isetval.write_dng(tmp_path / "disks.dng", isetval.Capture.from_array(codes, time_s=0.01))
    page = tmp_path / "disks.html"
    assert main(["measure", str(tmp_path / "disks.dng"), "--role", "disk", "-o", str(page), "-q"]) == 0
    text = page.read_text()
    assert "disks.dng: disks</h2>" in text
    result = json.loads(re.search(r'id="data-json">(.*?)</script>', text, re.S).group(1))
    drawn = [d for d in result["curves"]["disks.dng: disks"]["disks"] if d["channel"] == "G"]
    assert len(drawn) == len(centers)
    for disk in drawn:  # the planted places and radius; .05 px is the sigma of a fit at this noise, several times
        assert min(np.hypot(disk["row_px"] - r, disk["col_px"] - c) for r, c in centers) < 0.2
        assert disk["radius_px"] == pytest.approx(12, abs=0.3)
