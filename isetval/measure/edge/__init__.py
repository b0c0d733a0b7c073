"""Slanted edges: SFR of one region or many, automatic finding of edges, profiles over the field."""

from isetval.core.lazy import lazy_names

_NAMES = {
    "EdgeRoi": "isetval.measure.edge.detect",
    "FoundEdges": "isetval.measure.edge.detect",
    "SfrResult": "isetval.measure.edge.result",
    "color_shift": "isetval.measure.edge.profile",
    "depth_of_field": "isetval.measure.edge.profile",
    "find_edges": "isetval.measure.edge.detect",
    "lens_profile": "isetval.measure.edge.profile",
    "sfr": "isetval.measure.edge.analysis",
    "sfr_batch": "isetval.measure.edge.analysis",
    "through_focus": "isetval.measure.edge.profile",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
