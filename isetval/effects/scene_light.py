"""The scene as it really is: light, chart, walls and stray light.  All act on the scene before it becomes radiance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, FreeAxis, parameter
from isetval.core.scene import ChartTarget, EdgeTarget, Scene
from isetval.effects.pupil import REFERENCE_NM, field_point

Float = NDArray[np.float64]
EXCITATION_BELOW_NM = 430.0  # optical brighteners absorb up to the violet


@dataclass(frozen=True, kw_only=True)
class LightNonuniformity(Effect):
    """A light field that is not even: a gradient and a radial part, fixed in the laboratory.

    Seen in full-frame flats only (a chart stays in its place).  The odd part looks like decenter (rotate
    the camera), the even part like vignetting and microlens (shift the camera).

    A lamp beside the axis is no tilt and a radial part alone: with the light of a point over a plane, (1 - 2 q + rho)^(-3/2),
    q = L.r/D^2, rho = r^2/D^2, the second order is -3/2 rho + 15/2 q^2, and of q^2 half stands across the radius: ``saddle``
    and ``twist``, for a lamp along x or y and between them.
    """

    name = "light_nonuniformity"
    stage = "scene"
    order = 10.0
    absent = "scenes of a chart or edge, which is lit by itself"
    imitated_by = (
        "vignetting",
        "microlens",
        "cos4",
        "decenter",
        "prnu",
    )
    free = FreeAxis("field radius", "strength", 0.5)
    equation = "L x (1 + a x + b y + c r^2 + d (x^2 - y^2) + 2 e x y), r = 1 at the corner"
    reference = "EMVA Standard 1288 Release 4.0, sec. 6.2 (homogeneity of the light source); second-order expansion"
    must_not_change = ("dark", "edge", "chart")

    tilt_x: float = parameter(0.0, unit="1/half diagonal", low=-0.9, high=0.9, tau=0.02, doc="rise a along x")
    tilt_y: float = parameter(0.0, unit="1/half diagonal", low=-0.9, high=0.9, tau=0.02, doc="rise b along y")
    radial: float = parameter(0.0, unit="1", low=-0.9, high=0.9, tau=0.03, doc="rise c at the corner")
    saddle: float = parameter(0.0, unit="1", low=-0.9, high=0.9, tau=0.01, shape=True, doc="rise d along x and fall along y")
    twist: float = parameter(0.0, unit="1", low=-0.9, high=0.9, tau=0.01, shape=True, doc="the same e along the diagonals")

    def apply_scene(self, scene: Scene, context: Context) -> Scene:
        """Add to the light field of a uniform target."""
        if scene.target is not None:
            return scene
        tilt = (scene.tilt[0] + self.tilt_x, scene.tilt[1] + self.tilt_y)
        xx, yy, xy = scene.bow
        bow = (xx + self.saddle, yy - self.saddle, xy + 2 * self.twist)
        return replace(scene, tilt=tilt, radial=scene.radial + self.radial, bow=bow)


@dataclass(frozen=True, kw_only=True)
class SpdMismatch(Effect):
    """A light whose spectrum is not the stated one: a tilt, a bow and a line.  Residuals under that light only.

    The ratio of two black bodies is exp(k / lambda): nearly all tilt, with a bow of a seventh to a quarter of it.
    A line is light of its own: it adds to whatever continuum there is, so that it is stated as a share of the mean radiance.
    It is looked for where narrow-band fluorescent lamps have theirs, and moves from there.

    ``light`` names the light it belongs to (empty: all).  Confounded with spectral crosstalk and a shift
    of the colour filters; a spectroradiometer or a second white tells.
    """

    name = "spd_mismatch"
    stage = "scene"
    order = 12.0
    absent = "lights whose spectrum was measured at the place of the target"
    imitated_by = (
        "spectral_crosstalk",
        "channel_gain",
        "cfa_angle_shift",
        "ir_leak",
        "fluorescence",
    )
    free = FreeAxis("wavelength", "gain", 0.1)
    equation = "max(0, L (1 + t x + b x^2) + spike mean(L) exp(-(lambda - lambda_s)^2 / (2 w^2))), x = (lambda - 550)/100 nm"
    reference = "CIE 15:2018, sec. 4 (tolerances of illuminants; narrow-band lamps FL10 to FL12); second-order expansion"
    must_not_change = ("dark",)
    per_light: ClassVar[bool] = True
    # Hg and Tb, Eu, Tb, Tb, Hg: nowhere from 410 to 640 nm farther than 29 nm, a filter's edge, from where one begins
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"spike_nm": (545.0, 611.0, 586.0, 488.0, 436.0)}

    light: str = ""
    tilt: float = parameter(0.0, unit="1/100 nm", low=-0.6, high=0.6, tau=0.05, doc="relative tilt t around 550 nm")
    bow: float = parameter(0.0, unit="1/(100 nm)^2", low=-0.2, high=0.4, tau=0.0125, doc="relative bow b around 550 nm")
    spike: float = parameter(0.0, unit="1", low=-1.0, high=100.0, tau=0.2, doc="height of the line, in mean radiances")
    spike_nm: float = parameter(545.0, unit="nm", low=300.0, high=1100.0, tau=60.0, shape=True, doc="place of the line")
    width_nm: float = parameter(10.0, unit="nm", low=1.0, high=200.0, tau=15.0, shape=True, doc="its standard deviation w")

    def content(self) -> tuple[Any, ...]:
        """Parameters and the light they belong to; without a line its place says nothing, and forms share what they simulate."""
        idle = () if self.spike else ("spike_nm", "width_nm")
        return (*(part for part in super().content() if part[0] not in idle), self.light)

    def apply_scene(self, scene: Scene, context: Context) -> Scene:
        """Change the light's spectrum in its own shots."""
        if self.light not in ("", context.light) or not (self.tilt or self.bow or self.spike):
            return scene
        distance = (scene.wavelength_nm - self.spike_nm) / self.width_nm
        x = (scene.wavelength_nm - REFERENCE_NM) / 100
        line = self.spike * np.mean(scene.white) * np.exp(-(distance**2) / 2)
        return replace(scene, white=np.maximum(scene.white * (1 + self.tilt * x + self.bow * x**2) + line, 0))


@dataclass(frozen=True, kw_only=True)
class PositionScale(Effect):
    """Light on a chart that depends on where the camera sees it: one smooth factor per field position.

    Confounded with vignetting and a gradient of the light, which edges tell of; the same patch at two positions tells.
    """

    name = "position_scale"
    stage = "scene"
    order = 14.0
    absent = "targets that stay where they are while the camera turns; edges, which are another target than the chart"
    imitated_by = (
        "vignetting",
        "cos4",
        "light_nonuniformity",
        "microlens",
    )
    free = FreeAxis("field radius", "strength", 0.5)
    equation = "L x (1 + a x + b y + c r^2) at the middle of the window, in half diagonals"
    reference = "second-order expansion of the light over set-ups"
    must_not_change = ("dark", "flat", "edge", "illumination")

    a: float = parameter(0.0, unit="1/half diagonal", low=-0.9, high=0.9, tau=0.02, doc="rise along x")
    b: float = parameter(0.0, unit="1/half diagonal", low=-0.9, high=0.9, tau=0.02, doc="rise along y")
    c: float = parameter(0.0, unit="1", low=-0.9, high=0.9, tau=0.03, doc="rise at the corner")

    def apply_scene(self, scene: Scene, context: Context) -> Scene:
        """Scale the light of shots of a chart."""
        if scene.target is None or isinstance(scene.target, EdgeTarget):
            return scene
        x, y = field_point(context)
        return scene.with_white(max(0.0, 1 + self.a * x + self.b * y + self.c * (x * x + y * y)))


@dataclass(frozen=True, kw_only=True)
class BlackReflectance(Effect):
    """Black elements that reflect a little: lift of black lines and dark sides only.

    Confounded with glare and ambient light; a light trap beside the black tells.
    """

    name = "black_reflectance"
    stage = "scene"
    order = 20.0
    absent = "light traps"
    imitated_by = (
        "veiling_glare",
        "ambient_light",
        "black_level",
    )
    equation = "rho of black elements + rho_b"
    reference = "Lyu et al., Accurate smartphone camera simulation using 3D scenes (black lines assumed to reflect nothing)"
    must_not_change = ("dark", "flat", "illumination")

    rho_b: float = parameter(0.0, unit="reflectance", low=0.0, high=1.0, tau=0.02, doc="reflectance added to black elements")

    def apply_scene(self, scene: Scene, context: Context) -> Scene:
        """Lift the black."""
        return replace(scene, black=scene.black + self.rho_b)


@dataclass(frozen=True, kw_only=True)
class ChartTilt(Effect):
    """A chart that is tilted to the light: a gradient over its patches, the same in all lights and channels.

    Confounded with a gradient of the light; turning the chart by 180 degrees tells.
    """

    name = "chart_tilt"
    stage = "scene"
    order = 22.0
    absent = "targets lit through their own diffuser; edges, which are another target than the chart"
    imitated_by = (
        "light_nonuniformity",
        "vignetting",
        "position_scale",
    )
    equation = "L x (1 + a x + b y) over the chart, x and y from -1 to 1 over the window"
    reference = "Lambert's cosine law, first order; Lyu et al., Accurate smartphone camera simulation using 3D scenes"
    must_not_change = ("dark", "flat", "edge", "illumination")

    a: float = parameter(0.0, unit="1", low=-0.9, high=0.9, tau=0.03, doc="rise from the middle to the right border")
    b: float = parameter(0.0, unit="1", low=-0.9, high=0.9, tau=0.03, doc="rise from the middle to the lower border")

    def apply_scene(self, scene: Scene, context: Context) -> Scene:
        """Tilt a target that has patches."""
        if scene.target is None or isinstance(scene.target, EdgeTarget):
            return scene
        return replace(scene, target_tilt=(scene.target_tilt[0] + self.a, scene.target_tilt[1] + self.b))


@dataclass(frozen=True, kw_only=True)
class Gloss(Effect):
    """Specular light on a chart: a white lift of all patches that may change with the field position.

    Confounded with ambient light and glare; crossed polarisers or a moved lamp tell.
    """

    name = "gloss"
    stage = "scene"
    order = 24.0
    absent = "matte targets, and lamps that stand 45 degrees aside"
    imitated_by = (
        "ambient_light",
        "veiling_glare",
        "black_reflectance",
    )
    free = FreeAxis("field radius", "strength", 0.5)
    equation = "rho + max(0, k + kx x + ky y) at the middle of the window, in half diagonals"
    reference = "Nicodemus et al., NBS Monograph 160 (1977) (specular part of reflectance); first-order expansion"
    must_not_change = ("dark", "flat", "illumination", "edge")

    level: float = parameter(0.0, unit="reflectance", low=0.0, high=1.0, tau=0.01, doc="lift k in the middle of the field")
    along_x: float = parameter(0.0, unit="reflectance", low=-1.0, high=1.0, shape=True, doc="change kx over a half diagonal")
    along_y: float = parameter(0.0, unit="reflectance", low=-1.0, high=1.0, shape=True, doc="change ky over a half diagonal")

    def apply_scene(self, scene: Scene, context: Context) -> Scene:
        """Lift the patches."""
        x, y = field_point(context)
        return replace(scene, gloss=scene.gloss + max(0.0, self.level + self.along_x * x + self.along_y * y))


@dataclass(frozen=True, kw_only=True)
class Fluorescence(Effect):
    """A patch (or paper) that turns violet light into blue light: one patch, and only where the light is violet.

    ``patch`` names the patch (empty: all).  The emitted radiance is a band at ``peak_nm`` in proportion to
    the light below 430 nm.
    """

    name = "fluorescence"
    stage = "scene"
    order = 26.0
    absent = "lights without violet, papers without brighteners"
    imitated_by = (
        "spd_mismatch",
        "gloss",
        "spectral_crosstalk",
    )
    equation = "L_patch + yield <L(lambda < 430 nm)> exp(-(lambda - peak)^2 / (2 w^2))"
    reference = "CIE 182:2007 (fluorescent samples); Gaussian emission is a convention"
    must_not_change = ("dark", "flat", "illumination", "edge")
    per_patch = True

    patch: str = ""
    emission: float = parameter(0.0, unit="1", low=0.0, high=10.0, tau=0.05, doc="emitted over mean exciting radiance (yield)")
    peak_nm: float = parameter(450.0, unit="nm", low=350.0, high=1100.0, tau=20.0, shape=True, doc="peak of the emission")
    width_nm: float = parameter(25.0, unit="nm", low=1.0, high=200.0, shape=True, doc="standard deviation w of the emission")

    def content(self) -> tuple[Any, ...]:
        """Parameters and the patch they belong to."""
        return (*super().content(), self.patch)

    def apply_scene(self, scene: Scene, context: Context) -> Scene:
        """Raise the patches' apparent reflectance under this light."""
        grid, violet = scene.wavelength_nm, scene.wavelength_nm < EXCITATION_BELOW_NM
        if not self.emission or not isinstance(scene.target, ChartTarget) or not violet.any():
            return scene
        band = np.exp(-(((grid - self.peak_nm) / self.width_nm) ** 2) / 2)
        emitted = self.emission * scene.white[violet].mean() * band
        added = np.divide(emitted, scene.white, out=np.zeros_like(emitted), where=scene.white > 0)
        so_far, names = scene.patch_added, [patch.name for patch in scene.target.patches]
        glowing = {name: so_far.get(name, 0.0) + added for name in names if self.patch in ("", name)}
        return replace(scene, patch_added={**so_far, **glowing})


@dataclass(frozen=True, kw_only=True)
class Interreflection(Effect):
    """Light that side walls throw onto a target, beyond what the render holds: colour that changes towards the wall.

    Confounded with errors of the wall's reflectance; a black cloth over one wall tells.
    """

    name = "interreflection"
    stage = "scene"
    order = 28.0
    absent = "targets without walls beside them"
    imitated_by = (
        "ambient_light",
        "spectral_crosstalk",
        "gloss",
    )
    equation = "E (1 + b rho_wall k), k the wall's view factor"
    reference = "Goral et al., SIGGRAPH 1984 (radiosity), first bounce"
    must_not_change = ("dark", "flat", "illumination")

    bounce: float = parameter(0.0, unit="1", low=-1.0, high=10.0, tau=0.2, doc="strength b of the further bounces")

    def apply_scene(self, scene: Scene, context: Context) -> Scene:
        """Strengthen the light from the walls."""
        return replace(scene, bounce=scene.bounce + self.bounce)


@dataclass(frozen=True, kw_only=True)
class AmbientLight(Effect):
    """Stray light of the room in front of the lens: added everywhere, whatever the scene; absent from capped darks.

    Confounded with glare (.93); a frame with the lamp off tells.
    """

    name = "ambient_light"
    stage = "scene"
    order = 40.0
    absent = "capped darks, dark rooms"
    imitated_by = (
        "veiling_glare",
        "black_reflectance",
        "black_level",
        "gloss",
    )
    free = FreeAxis("wavelength", "share", 0.5)
    equation = "L + L_a max(0, 1 + tilt (lambda - 550)/100)"
    reference = "ISO 18844:2017 (stray light of the set-up)"
    must_not_change = ("dark",)

    radiance: float = parameter(0.0, unit="W/(sr m2 nm)", low=0.0, high=1e3, tau=3e-5, doc="stray radiance L_a at 550 nm")
    tilt: float = parameter(0.0, unit="1/100 nm", low=-0.6, high=0.6, tau=0.1, shape=True, doc="relative tilt of its spectrum")

    def apply_scene(self, scene: Scene, context: Context) -> Scene:
        """Add to the stray light, unless the lens is capped."""
        if not self.radiance or context.role == "dark":
            return scene
        added = self.radiance * np.maximum(0.0, 1 + self.tilt * (scene.wavelength_nm - REFERENCE_NM) / 100)
        return replace(scene, ambient=added if scene.ambient is None else scene.ambient + added)
