"""Plots draw what the lens functions return."""

from __future__ import annotations

import numpy as np
import pytest
from lens_models import thin_lens

from isetval.app.plots.lens import audit_figure, depth_of_field_figure, focus_figure, mtf_figure, spot_figure
from isetval.lens.auditing import audit
from isetval.lens.known_lenses import default_lens


def test_audit_figure_shows_the_audits_curves() -> None:
    result = audit(default_lens(), stated_focus={0.3: 0.5})
    figure = audit_figure(result)
    line = figure.axes[0].lines[0]
    np.testing.assert_allclose(line.get_ydata(), result.relative_illumination)
    assert len(figure.axes[3].lines) == 2


def test_lens_figures_have_one_curve_per_field_and_direction() -> None:
    lens = thin_lens(4.4, 8.0)
    assert len(mtf_figure(lens, heights_mm=[0.0, 1.0], film_mm=4.4).axes[0].lines) == 4
    assert len(spot_figure(lens, heights_mm=[0.0, 1.0], film_mm=4.45).axes) == 2
    curve = focus_figure(lens, objects_m=(0.3, 1.0)).axes[0].lines[0].get_ydata()
    assert curve[0] > curve[1]


def test_depth_of_field_peaks_at_the_focus_and_is_the_jinc_of_the_defocus_disc() -> None:
    from scipy.special import j1

    focal, f_number, focus, near = 4.4, 8.0, 0.5, 0.2
    lens = thin_lens(focal, f_number)
    line = depth_of_field_figure(lens, focus_m=[focus], frequency_cy_mm=50.0, objects_m=[near, focus, 5.0]).axes[0].lines[0]
    found = line.get_ydata()
    assert found[1] == max(found)
    # diameter of the blur: pupil times the difference of the image distances over that of the object
    images = [1 / (1 / focal - 1e-3 / distance) for distance in (focus, near)]
    x = np.pi * 50.0 * focal / f_number * (images[1] - images[0]) / images[1]
    # the sharp value holds the diffraction of both, to a percent
    assert found[0] / found[1] == pytest.approx(abs(2 * j1(x) / x), abs=0.02)


def test_the_audit_command_draws_its_figures(tmp_path) -> None:
    from isetval.app.cli import main
    from isetval.core.toml import data_folder

    lens = data_folder() / "lens" / "default_lens.json"
    assert main(["lens", "audit", str(lens), "-q", "-o", str(tmp_path / "a.png")]) == 0
    assert (tmp_path / "a.png").read_bytes()[1:4] == b"PNG"
    assert main(["lens", "audit", str(lens), "-q", "-o", str(tmp_path / "a.txt")]) == 3


@pytest.mark.slow
def test_the_audit_as_pdf_has_focus_spots_mtf_and_depth_of_field(tmp_path) -> None:
    from isetval.app.cli import main
    from isetval.core.toml import data_folder

    lens = data_folder() / "lens" / "default_lens.json"
    assert main(["lens", "audit", str(lens), "-q", "-o", str(tmp_path / "a.pdf")]) == 0
    assert (tmp_path / "a.pdf").read_bytes().count(b"/Type /Page ") == 5


@pytest.mark.slow
def test_the_audit_as_a_page_says_each_contradiction_and_draws_five_pictures(tmp_path) -> None:
    from html import unescape

    from isetval.app.cli import main
    from isetval.core.toml import data_folder
    from isetval.lens import audit_file

    lens = data_folder() / "lens" / "default_lens.json"
    page = tmp_path / "a.html"
    assert main(["lens", "audit", str(lens), "-q", "--f-number", "1.2", "-o", str(page)]) == 0
    text = unescape(page.read_text())
    flags = audit_file(lens, stated_f_number=1.2).flags
    assert flags
    assert all(flag.found in text and flag.remedy in text for flag in flags)
    assert text.count("data:image/svg+xml") == 5
