"""Relative illumination: fall-off curve, centre, tilt, colour shading, 2-D map."""

from isetval.core.lazy import lazy_names

_NAMES = {
    "FalloffPlane": "isetval.measure.shading.results",
    "RelativeIllumination": "isetval.measure.shading.results",
    "RotatedSeparation": "isetval.measure.shading.rotated",
    "compare_with_prediction": "isetval.measure.shading.prediction",
    "relative_illumination": "isetval.measure.shading.falloff",
    "separate_rotated": "isetval.measure.shading.rotated",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
