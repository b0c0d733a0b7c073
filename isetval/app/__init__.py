"""What people start: the command line, reports, plots, the demo, challenges."""

from isetval.core.lazy import lazy_names

_NAMES = {"plots": "isetval.app.plots", "report": "isetval.app.report"}
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
