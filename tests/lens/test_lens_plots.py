"""Plots draw what the lens functions return."""

from __future__ import annotations

import numpy as np
from lens_models import thin_lens

from isetval.app.plots.lens import audit_figure, focus_figure, mtf_figure, spot_figure
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
