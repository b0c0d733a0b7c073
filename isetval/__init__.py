"""isetval: a ruler and a detective for camera models."""

from isetval.core.lazy import lazy_names
from isetval.core.shown import drawn_by
from isetval.core.version import VERSION

__version__ = VERSION
_NAMES = {
    "Campaign": "isetval.core.campaign",
    "CameraModel": "isetval.camera.model",
    "Capture": "isetval.core.capture",
    "Effect": "isetval.core.effect",
    "Exposure": "isetval.core.sensor",
    "InputError": "isetval.core.errors",
    "Metric": "isetval.core.metric",
    "MetricTable": "isetval.core.metric",
    "Sensor": "isetval.core.sensor",
    "Shot": "isetval.core.campaign",
    "Signal": "isetval.core.signal",
    "compare": "isetval.loop.comparison",
    "diagnose": "isetval.loop",
    "effects": "isetval.effects",
    "identify": "isetval.loop",
    "lens": "isetval.lens",
    "load_campaign": "isetval.files.campaign_file",
    "load_model": "isetval.camera.model_file",
    "measure": "isetval.measure",
    "measure_campaign": "isetval.measure.campaign",
    "read_capture": "isetval.files.capture_file",
    "plots": "isetval.app",
    "read_dng": "isetval.files.dng",
    "read_image": "isetval.files.image_file",
    "report": "isetval.app",
    "simulate": "isetval.camera.shooting",
    "testing": "isetval.testing",
    "write_dng": "isetval.files.dng",
}
__all__ = sorted(_NAMES)
drawn_by("isetval.app.plots.drawing")
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
