"""isetval: a ruler and a detective for camera models."""

from isetval._lazy import lazy_names

__version__ = "0.1.0"

_NAMES = {
    "Campaign": "isetval.core.campaign",
    "CameraModel": "isetval.model",
    "Capture": "isetval.core.capture",
    "Effect": "isetval.core.effect",
    "Exposure": "isetval.core.sensor",
    "InputError": "isetval.core.errors",
    "Metric": "isetval.core.metric",
    "MetricTable": "isetval.core.metric",
    "Sensor": "isetval.core.sensor",
    "Shot": "isetval.core.campaign",
    "Signal": "isetval.core.signal",
    "compare": "isetval.comparison",
    "diagnose": "isetval.diagnosis",
    "identify": "isetval.diagnosis",
    "load_campaign": "isetval.campaignfile",
    "load_model": "isetval.modelfile",
    "measure": "isetval.measure",
    "measure_campaign": "isetval.measure.campaign",
    "read_dng": "isetval.dng",
    "simulate": "isetval.shooting",
    "testing": "isetval.testing",
    "write_dng": "isetval.dng",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
