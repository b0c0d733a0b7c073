"""The figures draw what the results hold."""

import numpy as np
import stored_metrics  # noqa: F401  (puts the flat-field generator on the path)
from chart_scenes import ChartScene
from flat_fields import Flat

from isetval.app.plots.color import chart_figure, profile_figure, qe_figure
from isetval.app.plots.shading import falloff_figure
from isetval.measure import chart, line_profile, relative_illumination, spectral_qe


def test_falloff_figure_shows_every_plane_and_the_prediction(tmp_path):
    result = relative_illumination(Flat(rows=256, cols=320).capture(np.random.default_rng(1)))
    radius = np.linspace(0, 2, 30)
    figure = falloff_figure(result, predictions={"design": (radius, 1 - 0.1 * radius**2)})
    labels = figure.axes[0].get_legend_handles_labels()[1]
    assert labels[:4] == ["R", "Gr", "Gb", "B"]
    assert "design" in labels
    figure.savefig(tmp_path / "falloff.png", dpi=50)
    assert falloff_figure(result).axes[1].get_ylabel().startswith("rings")


def test_chart_profile_and_matrix_figures(tmp_path):
    scene = ChartScene(rows=300, cols=420, center=(150.0, 210.0), pitch_px=45.0)
    capture = scene.capture(np.random.default_rng(2))
    corners = [scene.to_pixel(d, a) for d, a in ((-0.45, -0.45), (-0.45, 5.45), (3.45, 5.45), (3.45, -0.45))]
    result = chart(capture, corners=corners)
    figure = chart_figure(result)
    assert "slope" in figure.axes[1].get_legend_handles_labels()[1][-1]
    profile = profile_figure(line_profile(capture, box=(210, 230, 40, 380)))
    assert profile.axes[1].get_ylabel() == "ratio, black removed"
    rng = np.random.default_rng(3)
    predicted = rng.uniform(50, 800, (3, 24, 3))
    matrix = spectral_qe(predicted * 0.6, predicted, sigma=1.0)
    third = qe_figure(matrix, None, predicted * 0.6, predicted)
    for k, part in enumerate((figure, profile, third)):
        part.savefig(tmp_path / f"{k}.png", dpi=50)
