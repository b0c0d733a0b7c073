"""DNG in and out: tags checked before samples, levels as exact rationals, the place on the sensor kept in the file."""

from isetval.core.lazy import lazy_names

_NAMES = {
    "DngInfo": "isetval.files.dng.metadata",
    "GainMap": "isetval.files.dng.metadata",
    "as_rational_time": "isetval.core.sensor",
    "describe_capture": "isetval.files.picture_quality",
    "describe_file": "isetval.files.dng.reader",
    "gain_maps": "isetval.files.dng.metadata",
    "noise_profile": "isetval.files.dng.metadata",
    "place_on_sensor": "isetval.files.dng.sensor_window",
    "read_dng": "isetval.files.dng.reader",
    "read_raw": "isetval.files.headerless_file",
    "simulation_info": "isetval.files.dng.metadata",
    "write_dng": "isetval.files.dng.writer",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
