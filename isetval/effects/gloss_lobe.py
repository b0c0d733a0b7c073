"""A glossy material: the blurred mirror image of a lamp on a chart."""

from __future__ import annotations

from dataclasses import dataclass, replace

from isetval.core.context import Context
from isetval.core.effect import Effect, parameter
from isetval.core.scene import ChartTarget, Highlight, Scene


@dataclass(frozen=True, kw_only=True)
class GlossLobe(Effect):
    """A chart of glossy material: a soft white highlight where its surface mirrors the lamp into the camera.

    A rough coat of slope deviation m mirrors a lamp that stands, with the camera, at a distance D into a spot of width 2 m D;
    over a flat chart it is a normal distribution.  The same white light on all patches, light or dark, at one place
    of the picture; gloss is the lift of charts that are wider lit than they are rough.
    """

    name = "gloss_lobe"
    stage = "scene"
    order = 24.5
    absent = "matte targets, and lamps whose mirror image lies beside the chart"
    imitated_by = ("gloss", "ambient_light", "chart_tilt", "black_reflectance")
    equation = "rho + k exp(-((x - x0)^2 + (y - y0)^2)/(2 w^2)), x and y from -1 to 1 over the window"
    reference = "Ward, SIGGRAPH 1992 (Gaussian lobe of slopes)"
    must_not_change = ("dark", "flat", "illumination", "edge")

    level: float = parameter(0.0, unit="reflectance", low=0.0, high=10.0, tau=0.02, doc="lift k in the middle of the highlight")
    x0: float = parameter(0.0, unit="half window", low=-3.0, high=3.0, tau=0.5, shape=True, doc="column place of the highlight")
    y0: float = parameter(0.0, unit="half window", low=-3.0, high=3.0, tau=0.5, shape=True, doc="row place of the highlight")
    width: float = parameter(0.5, unit="half window", low=0.02, high=10.0, tau=0.3, shape=True, doc="standard deviation w")

    def apply_scene(self, scene: Scene, context: Context) -> Scene:
        """Add the highlight to a chart."""
        if not self.level or not isinstance(scene.target, ChartTarget):
            return scene
        return replace(scene, highlights=(*scene.highlights, Highlight(self.level, (self.x0, self.y0), self.width)))
