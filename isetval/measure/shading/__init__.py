"""Relative illumination: curve over the field, centre, tilt, colour shading, 2-D map."""

from isetval.core.lazy import lazy_names

_NAMES = {
    "PlaneIllumination": "isetval.measure.shading.results",
    "RelativeIllumination": "isetval.measure.shading.results",
    "RotatedSeparation": "isetval.measure.shading.comparisons",
    "compare_with_prediction": "isetval.measure.shading.comparisons",
    "relative_illumination": "isetval.measure.shading.measurement",
    "separate_rotated": "isetval.measure.shading.comparisons",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
