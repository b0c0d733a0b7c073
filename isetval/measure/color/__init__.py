"""Colour charts: finding, patch means, spectral quantum efficiency, line profiles."""

from isetval.core.lazy import lazy_names

_NAMES = {
    "ChartResult": "isetval.measure.color.chartresult",
    "LineProfile": "isetval.measure.color.profile",
    "PatchRows": "isetval.measure.color.patches",
    "SpectralQE": "isetval.measure.color.qeresult",
    "chart": "isetval.measure.color.patchchart",
    "chart_patches_at": "isetval.measure.color.patches",
    "line_profile": "isetval.measure.color.profile",
    "patches_over_frames": "isetval.measure.color.frames",
    "predicted_responses": "isetval.measure.color.crosstalk",
    "spectral_qe": "isetval.measure.color.crosstalk",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
