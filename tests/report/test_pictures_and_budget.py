"""Error budget, captures beside simulations, and one exposure along the light path."""

import base64
import io
import json
import shutil
import subprocess

import numpy as np
import pytest
from matplotlib.image import imread

from isetval.app.report import report_html
from isetval.app.report.budget_parts import budget, light_paths
from isetval.app.report_pictures import comparison_pictures
from isetval.camera.light_path import light_path
from isetval.camera.model_file import make_effect
from isetval.loop.prepared import DARK_REPLICAS

CHROMIUM = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)


def test_the_light_path_follows_the_equations_of_its_effects(model, captures):
    shot = next(s for s in captures.shots if s.name == "A_flat4")
    steps = {s.effect: s for s in light_path(model, shot, lights=captures.lights)}
    assert [s.unit for s in steps.values()][:2] == ["W/(sr m2)", "W/m2"]
    # irradiance behind a round pupil at a large distance: pi L / (4 N^2), of an edge's two sides alike
    e_over_l = steps["aperture"].mean / steps["scene"].mean
    assert e_over_l == pytest.approx(np.pi / (4 * 1.73**2), rel=1e-6)
    gain = steps["conversion_gain"].mean / steps["read_noise"].mean
    assert gain == pytest.approx(0.1707, rel=1e-6)
    assert steps["black_level"].mean - steps["conversion_gain"].mean == pytest.approx(64)
    mean_e, pixels = steps["dark_current"].mean, steps["shot_noise"].picture.size
    own = steps["shot_noise"].picture - steps["dark_current"].picture
    assert own.var() == pytest.approx(mean_e, rel=5 * np.sqrt(2 / pixels))  # Poisson, mosaic of unequal means: their average
    assert steps["conversion_gain"].change is None  # the unit changes
    assert steps["prnu"].change == pytest.approx(0, abs=5 * 0.0054 / np.sqrt(pixels))


def test_an_effect_changes_what_stands_behind_it_and_nothing_before(model, captures):
    shot = next(s for s in captures.shots if s.name == "A_flat4")
    other = model.with_effect(make_effect("vignetting", {"v": 0.1}, "a test"))
    plain, more = (light_path(m, shot, lights=captures.lights) for m in (model, other))
    place = [s.effect for s in more].index("vignetting")
    assert [s.mean for s in plain[:place]] == [s.mean for s in more[:place]]
    assert len(more) == len(plain) + 1


def test_captures_stand_beside_simulations_on_one_scale(model, captures):
    better = model.with_effect(model.effect("dark_current").changed(rate_e_per_s=2.0))
    found = comparison_pictures([model, better], captures)
    assert {c["role"] for c in found["crops"]} == {"dark", "flat", "edge"}
    dark = next(c for c in found["crops"] if c["role"] == "dark")
    assert dark["shot"] == "A_dark2"  # the longest: there the charge shows

    def brightness(url):
        return float(imread(io.BytesIO(base64.b64decode(url.partition(",")[2])))[..., 0].mean())

    measured, wrong, right = brightness(dark["measured"]), *(brightness(s["picture"]) for s in dark["simulated"])
    assert abs(measured - right) < 0.2 * abs(measured - wrong)
    assert len(found["light_path"]) == 2
    assert all(path["pictures"] for path in light_paths(found))


def test_the_budget_adds_up_and_tells_a_wrong_model_from_a_right_one(result):
    rows = {(r["model"], r["family"]): r for r in result["budget"]}
    for row in rows.values():
        assert sum(row[k] for k in ("sampling", "specimen", "simulation", "render", "color", "light")) == pytest.approx(1)
        # R replicas add 1/R of the captures' variance; the flicker stands beside both
        known = 1 - row["light"]
        few, many = (known / (1 + n) for n in (result["settings"]["replicas"], DARK_REPLICAS))
        if row["family"].startswith("dark") and row["model"] != "pixel4a":  # those that hold for the mended model, too, are kept
            assert many - 1e-9 <= row["simulation"] <= few + 1e-9
        else:
            assert row["simulation"] == pytest.approx(many if row["family"].startswith("dark") else few)
    assert rows["pixel4a", "dark_mean"]["unexplained"] > 100
    assert rows["mended", "dark_mean"]["unexplained"] < 5 * np.sqrt(2 / rows["mended", "dark_mean"]["n"])
    told = {row["family"]: row["helps"] for row in budget(result)}
    assert told["dark mean"] != "the model"
    assert {row["family"]: row["helps"] for row in budget(result | {"budget": result["budget"][: len(rows) // 2]})}[
        "dark mean"
    ] == "the model"


def test_the_page_shows_them_and_needs_no_network(result):
    page = report_html([result])
    for words in (
        "Error budget",
        "Capture beside simulation",
        "One exposure along the light path",
        "before: pixel4a",
        "after: mended",
    ):
        assert words in page
    assert "http://" not in page.replace("http://www.w3.org", "")


KEYS = """
<script>
window.addEventListener("load", function () {
  var every = document.querySelectorAll(".plot svg");
  var plot = Array.prototype.find.call(every, function (p) { return p.querySelectorAll("circle").length > 2; });
  plot.focus();
  var first, told = function () {
    var line = plot.closest(".plot").querySelector(".told");
    return line ? line.textContent : "";
  };
  function press(key) { document.activeElement.dispatchEvent(new KeyboardEvent("keydown", { key: key, bubbles: true })); }
  press("ArrowRight"); first = told(); press("ArrowRight");
  var second = told(), mark = plot.querySelector(".layer:not(.off) circle").getBoundingClientRect();
  plot.dispatchEvent(new MouseEvent("click", { bubbles: true, clientX: mark.left + 12, clientY: mark.top + 12 }));
  document.title = JSON.stringify([first, second, told(), document.querySelectorAll("circle[tabindex='0']").length]);
});
</script>
"""


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_marks_are_read_by_arrow_keys_and_by_a_finger_beside_them(result, tmp_path):
    (tmp_path / "page.html").write_text(report_html([result]).replace("</body>", KEYS + "</body>"))
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--window-size=390,900", "--dump-dom"]
    done = subprocess.run([*command, f"file://{tmp_path}/page.html"], capture_output=True, text=True, timeout=120, check=False)
    title = done.stdout.partition("<title>")[2].partition("</title>")[0]
    first, second, touched, stops = json.loads(title)
    assert "z" in first
    assert second
    assert first != second
    assert touched
    assert stops == 0  # one stop of the tab key a plot, not one a mark
