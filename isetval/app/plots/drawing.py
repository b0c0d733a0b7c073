"""Which plot draws which result: what ``result.plot()`` and notebooks show."""

from __future__ import annotations

import base64
from collections.abc import Callable
from functools import singledispatch
from typing import TYPE_CHECKING, Any

from isetval.app.plots.color import plot_chart, plot_color_error, plot_profile, plot_qe_residuals
from isetval.app.plots.dark_series import plot_dark_mean
from isetval.app.plots.edges import plot_focus_curve, plot_lens_profile, plot_regions, plot_sfr
from isetval.app.plots.loop import plot_comparison, plot_diagnosis, plot_identifiability, plot_metrics
from isetval.app.plots.noise import plot_patches, plot_photon_transfer
from isetval.app.plots.panels import figure_bytes
from isetval.app.plots.shading import plot_relative_illumination
from isetval.core.metric import MetricTable
from isetval.loop.comparison import Comparison
from isetval.loop.identifiability import Identifiability
from isetval.loop.result import Diagnosis
from isetval.measure.color.chart_measurement import ChartResult
from isetval.measure.color.color_error import ColorError
from isetval.measure.color.profile import LineProfile
from isetval.measure.color.qe_data import SpectralQE
from isetval.measure.edge.edge_finding import FoundEdges
from isetval.measure.edge.field_and_focus import FocusCurve, LensProfile
from isetval.measure.edge.sfr_result import SfrResult
from isetval.measure.noise.dark_frames import Dark
from isetval.measure.noise.patch_noise import PatchTable
from isetval.measure.noise.transfer_result import PhotonTransfer
from isetval.measure.shading.results import RelativeIllumination

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@singledispatch
def draw(result: Any, ax: Axes | None = None) -> Axes:
    """The main picture of a result; register a plot for a class of your own with ``draw.register(cls)``.

    Raises
    ------
    TypeError
        For a class that no plot was registered for.
    """
    raise TypeError(f"{type(result).__name__} has no picture; register one with isetval.plots.draw.register")


PLOTS: dict[type, Callable[..., Axes]] = {
    ChartResult: plot_chart,
    ColorError: plot_color_error,
    Comparison: plot_comparison,
    Dark: plot_dark_mean,
    Diagnosis: plot_diagnosis,
    FocusCurve: plot_focus_curve,
    FoundEdges: plot_regions,
    Identifiability: plot_identifiability,
    LensProfile: plot_lens_profile,
    LineProfile: plot_profile,
    MetricTable: plot_metrics,
    PatchTable: plot_patches,
    PhotonTransfer: plot_photon_transfer,
    RelativeIllumination: plot_relative_illumination,
    SfrResult: plot_sfr,
    SpectralQE: plot_qe_residuals,
}
for _kind, _plot in PLOTS.items():
    draw.register(_kind, _plot)


def picture_url(result: Any) -> str:
    """The main picture as a PNG in a ``data:`` address."""
    figure = draw(result).get_figure(root=True)
    assert figure is not None
    return "data:image/png;base64," + base64.b64encode(figure_bytes(figure, "png")).decode("ascii")
