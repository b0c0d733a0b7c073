"""Checks for people who add an effect or an analysis, and the pytest plugin of stored metrics.

>>> from isetval.testing import check_effect
>>> check_effect(MyEffect(strength=0.1))        # doctest: +SKIP
"""

from isetval.core.lazy import lazy_names

_NAMES = {
    "Pulls": "isetval.testing.measurements",
    "check_effect": "isetval.testing.effects",
    "check_measurement": "isetval.testing.measurements",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
