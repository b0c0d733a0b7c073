"""The detective: which physical effect is missing, how sure, what else, what next."""

from isetval._lazy import lazy_names

_NAMES = {
    "Diagnosis": "isetval.diagnosis.result",
    "diagnose": "isetval.diagnosis.detective",
    "identify": "isetval.diagnosis.identifiability",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
