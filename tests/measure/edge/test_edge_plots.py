"""The pictures show every region, the verdicts and the definition of the axis."""

import io

from edge_cases import AIRY
from edge_charts import Chart

from isetval.app.plots.edges import found_edges_figure, pair_figure, sfr_figure
from isetval.measure.edge import find_edges, sfr
from isetval.scenes.edge_truth import EdgeTruth, edge_capture


def texts(figure):
    return [text.get_text() for axis in figure.axes for text in axis.texts]


def test_found_edges_figure_shows_used_and_rejected():
    scene = Chart(220, 480)
    scene.square(110, 100, 90, 8.0)
    scene.bar_code(110, 330)
    capture = scene.capture()
    found = find_edges(capture)
    results = [sfr(capture, roi) for roi in found]
    figure = found_edges_figure(capture, found, results)
    figure.savefig(io.BytesIO(), format="png", dpi=40)
    shown = texts(figure)
    assert len(shown) == len(found) + len(found.rejected)
    assert f"{results[0].mtf50_cy_px:.3f}" in shown
    assert "pattern" in shown
    assert len(figure.axes[0].patches) == len(shown)


def test_sfr_figure_names_axis_and_verdict():
    capture = edge_capture(EdgeTruth(AIRY), snr_bright=60)
    figure = sfr_figure(capture, sfr(capture))
    figure.savefig(io.BytesIO(), format="png", dpi=40)
    assert "accepted" in figure.axes[0].get_title()
    assert "edge normal" in figure.axes[2].get_xlabel()
    bad = edge_capture(EdgeTruth(AIRY, angle_deg=0.0))
    assert "angle_near_0" in sfr_figure(bad, sfr(bad)).axes[0].get_title()


def test_pair_figure():
    pair = [edge_capture(EdgeTruth(AIRY), snr_bright=60, seed=s) for s in (1, 2)]
    figure = pair_figure((pair[0], sfr(pair[0])), (pair[1], sfr(pair[1])))
    figure.savefig(io.BytesIO(), format="png", dpi=40)
    assert len(figure.axes[2].lines) == 3
