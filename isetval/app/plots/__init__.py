"""Plots: the only home of matplotlib.

``plot_x(result, ax=None)`` draws one panel into given axes, or into a figure of its own, and returns the axes;
``isetval.plots.plot_sfr(isetval.measure.sfr(capture)).figure.savefig("sfr.png")``.
"""

from isetval.core.lazy import lazy_names

_NAMES = {
    "draw": "isetval.app.plots.drawing",
    "plot_chart": "isetval.app.plots.color",
    "plot_color_error": "isetval.app.plots.color",
    "plot_comparison": "isetval.app.plots.loop",
    "plot_dark_codes": "isetval.app.plots.dark_series",
    "plot_dark_lines": "isetval.app.plots.dark_series",
    "plot_dark_mean": "isetval.app.plots.dark_series",
    "plot_dark_noise": "isetval.app.plots.dark_series",
    "plot_diagnosis": "isetval.app.plots.loop",
    "plot_disk_sfr": "isetval.app.plots.disk_sheet",
    "plot_disks": "isetval.app.plots.disk_sheet",
    "plot_edge_profile": "isetval.app.plots.edges",
    "plot_edges": "isetval.app.plots.edges",
    "plot_fixed_pattern": "isetval.app.plots.noise",
    "plot_focus_curve": "isetval.app.plots.edges",
    "plot_frame": "isetval.app.plots.edges",
    "plot_identifiability": "isetval.app.plots.loop",
    "plot_illumination_residuals": "isetval.app.plots.shading",
    "plot_lens_profile": "isetval.app.plots.edges",
    "plot_metrics": "isetval.app.plots.loop",
    "plot_mtf50": "isetval.app.plots.edges",
    "plot_noise_line": "isetval.app.plots.color",
    "plot_patches": "isetval.app.plots.noise",
    "plot_photon_transfer": "isetval.app.plots.noise",
    "plot_profile": "isetval.app.plots.color",
    "plot_profile_ratios": "isetval.app.plots.color",
    "plot_qe_residuals": "isetval.app.plots.color",
    "plot_regions": "isetval.app.plots.edges",
    "plot_relative_illumination": "isetval.app.plots.shading",
    "plot_sfr": "isetval.app.plots.edges",
    "plot_transfer_residuals": "isetval.app.plots.noise",
    "plot_trend": "isetval.app.plots.trend",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
