"""Raw files in and out: DNG reader and writer, headerless raw, quality remarks on a mosaic."""

from isetval._lazy import lazy_names

_NAMES = {
    "DngInfo": "isetval.dng.info",
    "GainMap": "isetval.dng.opcodes",
    "as_rational_time": "isetval.dng.rationals",
    "describe_capture": "isetval.dng.checks",
    "describe_file": "isetval.dng.reader",
    "gain_maps": "isetval.dng.opcodes",
    "noise_profile": "isetval.dng.info",
    "place_on_sensor": "isetval.dng.placement",
    "read_dng": "isetval.dng.reader",
    "read_raw": "isetval.dng.raw_file",
    "simulation_info": "isetval.dng.info",
    "write_dng": "isetval.dng.writer",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
