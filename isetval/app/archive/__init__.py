"""An archive of measurements: rows of many captures in a Parquet dataset, asked in SQL, drawn against time."""

from isetval.core.lazy import lazy_names

_NAMES = {"Archive": "isetval.app.archive.dataset", "trend_of": "isetval.app.archive.trend"}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
