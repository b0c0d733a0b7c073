"""Slanted edges: SFR of one region or many, automatic finding of edges, profiles over the field.

A region goes through these steps, one file each: ``measure_regions`` (``sfr``: all of it), ``samples`` (pixels of one
plane, linear), ``geometry`` (regions side by side, lines, distances), ``first_look`` (crossings, robust line, is it one
edge?), ``alternating_fit`` (the estimator: ``line_refinement`` with ``row_shifts``, ``illumination``, ``spline_bins``,
``esf_fit`` with ``esf_prior`` and ``marginal_likelihood``, in rounds),
``clipped_tails`` (noise cut off at white), ``spectrum`` (MTF and its covariance), ``verdict``
with ``overshoot``, ``result_of_fit`` and ``sfr_result``.  Beside them: ``iso12233`` (published procedures),
``edge_finding`` with ``contours`` (``find_edges``), ``field_and_focus`` (curves over the field, through focus).
"""

from isetval.core.lazy import lazy_names

_NAMES = {
    "EdgeRoi": "isetval.measure.edge.edge_finding",
    "FoundEdges": "isetval.measure.edge.edge_finding",
    "SfrResult": "isetval.measure.edge.sfr_result",
    "color_shift": "isetval.measure.edge.field_and_focus",
    "depth_of_field": "isetval.measure.edge.field_and_focus",
    "find_edges": "isetval.measure.edge.edge_finding",
    "lens_profile": "isetval.measure.edge.field_and_focus",
    "sfr": "isetval.measure.edge.measure_regions",
    "sfr_batch": "isetval.measure.edge.measure_regions",
    "through_focus": "isetval.measure.edge.field_and_focus",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
