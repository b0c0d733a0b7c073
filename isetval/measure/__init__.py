"""The ruler: analyses of captures.  Knows no model, no effect and no file format."""

from isetval.core.lazy import lazy_names

_NAMES = {
    "chart": "isetval.measure.color",
    "dark": "isetval.measure.noise",
    "disk_sfr": "isetval.measure.edge.disk_results",
    "disks": "isetval.measure.edge.disk_edges",
    "emva1288": "isetval.measure.noise",
    "find_disks": "isetval.measure.edge.disk_edges",
    "find_edges": "isetval.measure.edge",
    "lateral_color": "isetval.measure.edge.disk_results",
    "lens_profile": "isetval.measure.edge",
    "line_profile": "isetval.measure.color",
    "measure_campaign": "isetval.measure.campaign",
    "photon_transfer": "isetval.measure.noise",
    "quality": "isetval.measure.noise",
    "relative_illumination": "isetval.measure.shading",
    "sfr": "isetval.measure.edge",
    "sfr_batch": "isetval.measure.edge",
    "spectral_qe": "isetval.measure.color",
    "uniform_patches": "isetval.measure.noise",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
