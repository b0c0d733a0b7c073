"""The report: what the first screen says, self-contained, and alive in a browser."""

import json
import re
import shutil
import subprocess

import pytest
from report_results import comparison_and_diagnosis
from report_results import metric as _metric

from isetval.app.report import report_html, write_report
from isetval.app.report.charts import _field_rows
from isetval.app.report.family_plots import family_plot
from isetval.app.words import shortfall_words
from isetval.core.errors import InputError

CHROMIUM = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)


@pytest.fixture
def results():
    return comparison_and_diagnosis()


def _text(page):
    body = re.sub(r"<(script|style)\b.*?</\1>", " ", page, flags=re.S)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", body))


def test_the_first_screen_answers_the_four_questions(results):
    page = report_html(results)
    words = _text(page.split("<h2>")[0])
    assert "The model lacks vignetting." in words
    assert re.search(r"Does it match\? nominal 18.50 .* → mended 1.01", words)
    assert "Where not?" in words
    assert re.search(r"flat mean 36\.0", words)
    assert "vignetting: v 0.1010 ± 0.0040" in words
    assert "cannot tell it from cos4" in words
    assert "How the error fell" in words


def test_the_page_does_not_call_captures_held_out_that_something_was_fitted_to(results):
    assert "captures that nothing was fitted to" in report_html(results)
    fitted = json.loads(json.dumps(results).replace('"prediction"', '"calibration"'))
    page = report_html(fitted)
    assert "captures that nothing was fitted to" not in page
    assert "Something was fitted to these captures." in page
    assert "captures that something was fitted to" in page


def test_what_fails_is_drawn_first_with_its_band_and_every_model(results):
    page = report_html(results)
    section = page.split("<h2>What fails, worst first</h2>")[1].split("<h2>")[0]
    assert re.findall(r"<b>(.*?)</b>", section) == ["flat mean"]  # the only family that fails
    assert section.count('data-model="0"') == section.count('data-model="1"') == 1
    assert section.count('class="sigma') == 4  # a band for each plane
    assert page.index("What fails") < page.index("<h2>Residuals</h2>")


@pytest.mark.parametrize(
    ("conditions", "label"),
    [
        (lambda i: {"frequency_cy_px": 0.05 * (1 + i // 4), "shot": "edge"}, "frequency, cy/px"),
        (lambda i: {"patch": f"patch {i // 4}"}, "patch"),
        (lambda i: {"exposure_s": 0.001 * 2 ** (i // 4), "field_x_mm": 0.0}, "exposure"),
        (lambda i: {"exposure_s": 0.01, "field_x_mm": 0.5 * (i // 4)}, "field radius, mm"),
        (lambda i: {"region": f"level {1 + i // 4}", "field_x_mm": 0.5 * (i % 2), "shot": "chart"}, "level of brightness"),
        (lambda i: {"field_x_mm": None}, "shot"),
    ],
    ids=["frequency", "patch", "exposure", "radius", "level", "shot"],
)
def test_any_family_is_drawn_over_the_condition_that_varies(conditions, label):
    rows = [_metric("m", "odd_family", 2.0, i, **conditions(i)) for i in range(24)]
    plot = family_plot("odd_family", [rows])
    assert label in plot.svg
    assert plot.hint == ""
    assert len(re.findall(r"<polyline", plot.svg)) + len(re.findall(r"<circle", plot.svg)) >= 4


def test_noise_against_level_is_a_curve_of_each_chart():
    rows = [
        _metric(
            "m", "chart_noise_by_level", 2.0, i, channel="R", region=f"level {1 + i // 2}", shot=f"chart_{i % 2}", field_x_mm=0.1
        )
        for i in range(16)
    ]
    assert len(re.findall(r"<polyline", family_plot("chart_noise_by_level", [rows]).svg)) == 2


def test_flats_of_several_exposures_make_no_fall_off():
    """Each exposure by itself: one that was seen in the middle alone says nothing of the field."""
    places = [(0.0, t) for t in (0.01, 0.02, 0.04)] + [(0.5, 0.04), (1.0, 0.04)]
    rows = [
        {"family": "flat_mean", "setup": "s", "channel": "R", "role": "flat", "field_x_mm": x, "field_y_mm": 0.0, "exposure_s": t}
        | {"measured": t * (1 - x / 2), "simulated": t * (1 - x / 2)}
        for x, t in places
    ]
    assert sorted(_field_rows(rows)) == [("R", 0.0, 1.0, 1.0), ("R", 0.5, 0.75, 0.75), ("R", 1.0, 0.5, 0.5)]


def test_of_many_curves_the_worst_are_drawn():
    rows = [
        _metric("m", "mtf", float(edge), i, shot=f"edge{edge}", channel="G", name="mtf", frequency_cy_px=0.05 * (1 + i))
        for edge in range(20)
        for i in range(10)
    ]
    plot = family_plot("mtf", [rows])
    assert plot.hint == "the 6 curves that fit worst, of 20"
    assert len(re.findall(r"<polyline", plot.svg)) == 6


def test_the_page_asks_nothing_of_the_network(results, tmp_path):
    page = write_report(results, tmp_path / "r.html").read_text()
    assert not re.findall(r"(?:src|href|action)\s*=\s*[\"'](?!#|data:)[^\"']+", page)
    assert not re.findall(r"url\((?!data:)|@import|https?://|//[a-z0-9.-]+\.[a-z]{2,}/", page)


def test_numbers_are_embedded_for_download(results):
    page = report_html(results)
    csv = re.search(r'id="data-csv">(.*?)</script>', page, re.S)[1].strip().splitlines()
    assert len(csv) == 1 + len(results[1]["table"])
    content = json.loads(re.search(r'id="data-json">(.*?)</script>', page, re.S)[1])
    assert content[0]["verdict"] == "attributed"


def test_a_single_comparison_and_a_single_measurement_make_pages(results):
    assert "mended agrees with the captures." in _text(report_html(results[1:]))
    one = {"name": "gain", "value": 0.17, "sigma": 0.001, "unit": "DN/e-", "channel": "R"}
    measured = {"kind": "measure", "metrics": [one], "skipped": [{"file": "x.dng", "reason": "broken"}], "notes": []}
    words = _text(report_html([measured]))
    assert "0.1700 ± 0.0010 DN/e-" in words
    assert "left out: x.dng: broken" in words


def test_two_measurements_are_set_side_by_side():
    def made(value):
        rows = [{"name": "gain", "value": value, "sigma": 0.003, "unit": "DN/e-", "channel": "R"}]
        return {"kind": "measure", "metrics": rows, "skipped": [], "notes": []}

    words = _text(report_html([made(0.17), made(0.18)]))
    # (0.18 - 0.17) / sqrt(2 * 0.003^2) = 2.357
    assert "+2.4" in words


def test_hostile_names_do_not_become_markup(results):
    results[1]["campaign"] = results[0]["campaign"] = "<script>alert(1)</script>"
    results[1]["table"][0]["shot"] = '"><img src=x onerror=alert(1)>'
    results[1]["table"][0]["z"] = 9.0
    page = report_html(results)
    assert "<script>alert" not in page
    assert "<img" not in re.sub(r'<script type="text/plain".*?</script>', "", page, flags=re.S)


def test_results_that_cannot_be_drawn_are_refused():
    with pytest.raises(InputError, match="effects"):
        report_html([{"kind": "effects"}])


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_a_click_changes_the_plots_in_a_browser(results, tmp_path):
    page = report_html(results)
    probe = """
<script>
window.addEventListener("load", function () {
  var shown = function () { return document.querySelectorAll('.layer:not(.off)[data-model="0"]').length; };
  var before = shown();
  document.querySelector('[data-show="1"]').click();
  var after = shown(), mark = document.querySelector('.plot circle[tabindex]');
  mark.dispatchEvent(new Event("focus"));
  var told = document.querySelector(".told").textContent;
  document.title = "layers " + before + " " + after + " " + (told === mark.querySelector("title").textContent);
});
</script>
</body>"""
    path = tmp_path / "r.html"
    path.write_text(page.replace("</body>", probe))
    words = [
        CHROMIUM,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        f"--user-data-dir={tmp_path / 'p'}",
        "--dump-dom",
        path.as_uri(),
    ]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)
    except subprocess.TimeoutExpired:
        pytest.skip("Chromium does not start on this machine")
    found = re.search(r"<title>layers (\d+) (\d+) (\w+)</title>", done.stdout)
    if found is None and not done.stdout.strip():
        pytest.skip("Chromium does not start on this machine")
    assert found is not None
    assert int(found[1]) > 0  # the page opens on "before"
    assert int(found[2]) == 0
    assert found[3] == "true"  # a mark says what it is without a mouse


@pytest.mark.parametrize(
    ("name", "present", "parameters", "words"),
    [
        ("veiling_glare", False, {"gamma": (0.03, None)}, "lacks veiling glare"),
        ("dark_current", True, {"rate_e_per_s": (1.9, 0.26)}, "has too little dark current"),
        ("dark_current", True, {"rate_e_per_s": (0.1, 0.26)}, "has too much dark current"),
        ("dark_current", True, {"rate_e_per_s": (0.1, 0.0)}, "lacks dark current"),
        ("microlens", True, {"m_red": (0.2, 0.1), "m_green": (0.05, 0.1)}, "has the wrong microlens"),
        ("decenter", True, {"x_um": (-20.0, 10.0)}, "has the wrong decenter"),
        ("of_a_package_that_is_gone", True, {"x": (2.0, 1.0)}, "has the wrong of a package that is gone"),
    ],
)
def test_words_for_what_a_model_has_too_little_of(name, present, parameters, words):
    entry = {k: {"value": value, "nominal": nominal} for k, (value, nominal) in parameters.items()}
    assert shortfall_words({"name": name, "present_in_model": present, "parameters": entry}) == words
