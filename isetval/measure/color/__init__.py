"""Colour charts: finding, patch means, colour error, spectral quantum efficiency, line profiles."""

from isetval.core.lazy import lazy_names

_NAMES = {
    "ChartResult": "isetval.measure.color.chart_measurement",
    "ColorError": "isetval.measure.color.color_error",
    "LineProfile": "isetval.measure.color.profile",
    "PatchRows": "isetval.measure.color.patch_statistics",
    "SpectralQE": "isetval.measure.color.qe_data",
    "chart": "isetval.measure.color.chart_measurement",
    "chart_patches_at": "isetval.measure.color.patch_statistics",
    "line_profile": "isetval.measure.color.profile",
    "patches_over_frames": "isetval.measure.color.repeated_frames",
    "predicted_responses": "isetval.measure.color.qe_data",
    "spectral_qe": "isetval.measure.color.qe_matrix",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
