"""The loop: what a model predicts for a campaign, where it fails, which effect is missing, and adding it."""

from isetval.core.lazy import lazy_names

_NAMES = {
    "Comparison": "isetval.loop.comparison",
    "Diagnosis": "isetval.loop.result",
    "compare": "isetval.loop.comparison",
    "diagnose": "isetval.loop.detective",
    "identify": "isetval.loop.identifiability",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
