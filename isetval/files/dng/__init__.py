"""Raw files in and out: DNG reader and writer, headerless raw, quality remarks on a mosaic."""

from isetval.core.lazy import lazy_names

_NAMES = {
    "DngInfo": "isetval.files.dng.info",
    "GainMap": "isetval.files.dng.opcodes",
    "as_rational_time": "isetval.core.rational",
    "describe_capture": "isetval.files.dng.checks",
    "describe_file": "isetval.files.dng.reader",
    "gain_maps": "isetval.files.dng.opcodes",
    "noise_profile": "isetval.files.dng.info",
    "place_on_sensor": "isetval.files.dng.placement",
    "read_dng": "isetval.files.dng.reader",
    "read_raw": "isetval.files.dng.raw_file",
    "simulation_info": "isetval.files.dng.info",
    "write_dng": "isetval.files.dng.writer",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
