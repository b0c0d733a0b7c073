"""Sensor noise: photon transfer, dark signal, EMVA 1288 decomposition, uniform patches, capture quality."""

from isetval.core.lazy import lazy_names

_NAMES = {
    "Quantity": "isetval.core.quantity",
    "dark": "isetval.measure.noise.dark_frames",
    "dark_statistics": "isetval.measure.noise.statistics",
    "emva1288": "isetval.measure.noise.emva",
    "flat_statistics": "isetval.measure.noise.statistics",
    "photon_transfer": "isetval.measure.noise.transfer",
    "quality": "isetval.measure.noise.capture_quality",
    "uniform_patches": "isetval.measure.noise.patch_noise",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
