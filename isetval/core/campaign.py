"""Campaigns: a plan of shots, what the laboratory knows about them, and the captures."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from isetval.core.cache import content_hash
from isetval.core.captures import Captures, MemoryCaptures
from isetval.core.errors import InputError
from isetval.core.given import GivenMetrics
from isetval.core.parameter import NuisanceKind, Parameter, split_key
from isetval.core.scene import ChartTarget, Spectrum, Target
from isetval.core.sensor import Exposure, Sensor, Window

ROLES = ("dark", "flat", "edge", "chart", "scene")
SCOPES = ("campaign", "measurement session", "set-up", "frame")
SHOT_NUISANCES = {
    "light_level": NuisanceKind("relative", "radiance of the light times (1 + value)", factor=True),
    "light_tilt_x": NuisanceKind("relative", "rise of the light along x from the middle to the end of the half diagonal (flats)"),
    "light_tilt_y": NuisanceKind("relative", "rise of the light along y from the middle to the end of the half diagonal (flats)"),
    "light_radial": NuisanceKind("relative", "rise of the light with the square of the field radius, at the corner (flats)"),
    "light_bow_x": NuisanceKind("relative", "rise of the light with the square of x, at the end of the half diagonal (flats)"),
    "light_bow_y": NuisanceKind("relative", "rise of the light with the square of y, at the end of the half diagonal (flats)"),
    "light_drift": NuisanceKind("relative", "rise of a light from its first to its last shot in a measurement session"),
    "spectrum_tilt": NuisanceKind("relative per 100 nm", "tilt of the light's spectrum around 550 nm"),
    "spectrum_bow": NuisanceKind("relative per (100 nm)^2", "bend of the light's spectrum: rise with the square around 550 nm"),
    "focus_um": NuisanceKind("um", "shift of the sensor from the stated focus", curved=True, focus=True),
    "edge_shift_px": NuisanceKind("px", "shift of an edge along its normal", curved=True),
    "edge_angle_deg": NuisanceKind("deg", "turn of an edge", curved=True),
    "target_tilt_x": NuisanceKind("relative", "rise of a target's brightness along x from its middle to the window's border"),
    "target_tilt_y": NuisanceKind("relative", "rise of a target's brightness along y from its middle to the window's border"),
    "target_bow_x": NuisanceKind("relative", "rise of a target's brightness with the square of x, at the window's border"),
    "target_bow_y": NuisanceKind("relative", "rise of a target's brightness with the square of y, at the window's border"),
    "target_twist": NuisanceKind("relative", "rise of a target's brightness with x y, in the window's corner"),
    "window_tilt_x": NuisanceKind("relative", "rise of the light on targets, window by window, along x to the half diagonal"),
    "window_tilt_y": NuisanceKind("relative", "rise of the light on targets, window by window, along y to the half diagonal"),
    "chart_shift_x_px": NuisanceKind("px", "shift of a chart's or scene's picture along x from the stated boxes", curved=True),
    "chart_shift_y_px": NuisanceKind("px", "shift of a chart's or scene's picture along y from the stated boxes", curved=True),
    "surround_reflectance": NuisanceKind("reflectance", "reflectance added to what lies around patches and edges"),
    "patch_reflectance": NuisanceKind(
        "relative", "reflectance of a chart's patch times (1 + value), each patch its own", factor=True, each_patch=True
    ),
    "patch_tilt": NuisanceKind(
        "relative per 100 nm", "tilt of the spectrum of a patch around 550 nm, each patch its own", each_patch=True
    ),
    "patch_bow": NuisanceKind(
        "relative per (100 nm)^2", "bend of the spectrum of a patch: rise with the square around 550 nm", each_patch=True
    ),
    "patch_color": NuisanceKind(
        "relative", "what a color channel sees of a patch times (1 + value), each patch, channel and light its own", of_rows=True
    ),
    "dark_reflectance": NuisanceKind("reflectance", "reflectance added to black elements"),
    "qe_red": NuisanceKind("relative", "quantum efficiency of red in this light times (1 + value)", factor=True),
    "qe_green": NuisanceKind("relative", "quantum efficiency of green (or of MONO) in this light times (1 + value)", factor=True),
    "qe_blue": NuisanceKind("relative", "quantum efficiency of blue in this light times (1 + value)", factor=True),
    "wall_albedo": NuisanceKind("relative", "reflectance of the side walls of a rendered scene times (1 + value)", factor=True),
    "scale": NuisanceKind("relative", "rows of a metrics file times (1 + value)", factor=True),
    "offset": NuisanceKind("unit of the rows", "value added to the rows of a metrics file"),
    "axis_stretch": NuisanceKind("relative", "radius, frequency or level of the rows of a metrics file times (1 + value)"),
}
STEP = 0.05
"""Longest finite step of a relative error, if its prior is not wider: metrics are linear that far, and rounding makes a noise of
one sigma in all rows together whatever the step, which a pull of 13 sigmas of a narrow prior multiplied."""
GIVEN_NUISANCES = ("scale", "offset", "axis_stretch")
"""Errors of whoever measured the rows of a metrics file: they act on those rows only, not on any light."""


def of_patch(nuisance: str, patch: str) -> str:
    """The name of the value that one patch has of a nuisance of its own."""
    return f"{nuisance}:{patch}"


@dataclass(frozen=True, eq=False)
class Light:
    """A light: radiance in W/(sr m2 nm) of a perfect white in it, or of itself where it is looked into."""

    name: str
    radiance: Spectrum
    file: str = ""
    column: str = ""

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the radiance, wherever its table lies."""
        return content_hash(self.radiance)


@dataclass(frozen=True)
class Nuisance:
    """A prior: how well the laboratory knows one number.

    ``parameter`` is one of `SHOT_NUISANCES` or ``effect.parameter`` of the camera model; ``sigma`` is
    the standard deviation around 0 (shot nuisances) or around the model's value; ``scope`` says what
    shares one value.  ``roles``, ``lights`` and ``setups`` restrict one of `SHOT_NUISANCES` (empty: all).
    """

    parameter: str
    sigma: float
    unit: str
    scope: str = "set-up"
    distribution: str = "normal"
    roles: tuple[str, ...] = ()
    lights: tuple[str, ...] = ()
    setups: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        where = f"nuisance {self.parameter}"
        if self.parameter not in SHOT_NUISANCES and not self.of_camera:
            known = ", ".join(SHOT_NUISANCES)
            raise InputError(f"{where}: unknown; it needs one of {known}, or effect.parameter of the camera model")
        if not self.sigma > 0:
            raise InputError(f"{where}: sigma is {self.sigma}; it needs a positive number (leave out what is exactly known)")
        if self.scope not in SCOPES:
            raise InputError(f"{where}: scope is {self.scope!r}; it needs one of {', '.join(SCOPES)}")
        if self.distribution != "normal":
            raise InputError(f"{where}: distribution is {self.distribution!r}; only 'normal' is known")
        if self.of_camera and self.scope == "frame":
            raise InputError(f"{where}: a camera parameter cannot have scope 'frame'; use campaign or measurement session")
        if self.of_camera and (some := [key for key in ("roles", "lights", "setups") if getattr(self, key)]):
            raise InputError(
                f"{where}: {some[0]} is {list(getattr(self, some[0]))}; a camera has its parameters in every shot: leave "
                f"{some[0]} out, scope says which shots share one value"
            )
        if self.of_rows and self.scope != "campaign":
            raise InputError(f"{where}: scope is {self.scope!r}; it needs 'campaign': one value for all shots in a light")
        if unknown := set(self.roles) - set(ROLES):
            raise InputError(f"{where}: role {unknown.pop()!r} is unknown; it needs some of {', '.join(ROLES)}")

    def applies_to(self, shot: Shot) -> bool:
        """Whether the shot is touched by this nuisance."""
        if self.parameter in GIVEN_NUISANCES and shot.given is None:
            return False
        found = ((self.roles, shot.role), (self.lights, shot.light or ""), (self.setups, shot.setup))
        return all(not wanted or name in wanted for wanted, name in found)

    @property
    def of_rows(self) -> bool:
        """Whether it weighs rows, and is neither simulated nor fitted."""
        return not self.of_camera and SHOT_NUISANCES[self.parameter].of_rows

    @property
    def marginalised(self) -> bool:
        """Whether it is integrated in closed form: what changes from frame to frame, and what rows alone have."""
        return self.scope == "frame" or self.of_rows

    @property
    def of_camera(self) -> bool:
        """Whether it is a tolerance of a camera parameter, which all shots of a scope share, dark or lit."""
        return "." in self.parameter

    def unknown(self, shot: Shot | None = None) -> Parameter:
        """The value that ``shot`` shares with others of its scope (no shot: with all)."""
        owner, name = split_key(self.parameter)
        if shot is None:
            return Parameter(name, owner, self.scope, unit=self.unit, prior=self.sigma, step=self.sigma)
        shared = {"campaign": "", "measurement session": shot.measurement_session, "set-up": shot.setup, "frame": shot.name}
        if self.of_camera:
            return Parameter(name, owner, self.scope, shared[self.scope], unit=self.unit, prior=self.sigma, step=self.sigma)
        kind = SHOT_NUISANCES[self.parameter]
        return Parameter(
            name,
            scope=self.scope,
            group=shared[self.scope],
            only=(*self.roles, *self.lights, *self.setups),
            unit=self.unit or kind.unit,
            prior=self.sigma,
            step=self.sigma
            if kind.curved or not kind.unit.startswith("relative")
            else max(self.sigma, min(4 * self.sigma, STEP)),
            curved=kind.curved,
            focus=kind.focus,
            low=-1.0 if kind.factor else -math.inf,
            factor=kind.factor,
        )

    def unknowns_of(self, shot: Shot | None = None) -> tuple[Parameter, ...]:
        """The values that ``shot`` shares with others: one, or one for each patch of its chart."""
        one = self.unknown(shot)
        if shot is None or self.of_camera or not SHOT_NUISANCES[self.parameter].each_patch:
            return (one,)
        patches = shot.target.patches if isinstance(shot.target, ChartTarget) else ()
        return tuple(replace(one, name=of_patch(self.parameter, patch.name), patch=patch.name) for patch in patches)


@dataclass(frozen=True, eq=False)
class Shot:
    """One set-up at one exposure with ``frames`` frames.

    ``window`` is (row0, col0, rows, cols) on the sensor, a `Window` or four numbers.  ``light_level`` scales the light's radiance
    as stated by the laboratory.  ``focus_um`` is the stated shift of the sensor from best focus,
    ``distance_m`` the distance of the target; with the exposure's ``focus_m`` defocus follows from both.  ``repeat_of``
    names the shot that this one repeats with a newly made set-up.  ``method`` and ``channel`` ask an estimator for
    another method than its own, or for one channel only: a simulation of the shot is then measured by the same.
    ``photons_per_pixel`` is what a calibrated light is stated to send to a pixel in one exposure (EMVA 1288).
    ``given`` are metrics that somebody else measured of this set-up, in place of or beside captures.  Of ``levels_only``
    captures (resampled pictures) means alone are the sensor's: no noise and no sharpness is measured.
    """

    name: str
    role: str
    setup: str = ""
    measurement_session: str = "A"
    exposure: Exposure = Exposure()
    frames: int = 1
    light: str | None = None
    light_level: float = 1.0
    rotation_deg: float = 0.0
    window: Window | None = None
    target: Target | None = None
    focus_um: float = 0.0
    distance_m: float | None = None
    repeat_of: str | None = None
    files: tuple[str, ...] = ()
    method: str = ""
    channel: str = ""
    photons_per_pixel: float | None = None
    given: GivenMetrics | None = None
    levels_only: bool = False

    def __post_init__(self) -> None:
        if self.role not in ROLES:
            raise InputError(f"shot {self.name}: role is {self.role!r}; it needs one of {', '.join(ROLES)}")
        if self.frames < 1:
            raise InputError(f"shot {self.name}: frames is {self.frames}; it needs at least 1")
        if not self.light_level >= 0:
            raise InputError(f"shot {self.name}: light_level is {self.light_level}; it needs 0 or more")
        if self.role in ("edge", "chart", "scene") and self.target is None:
            raise InputError(f"shot {self.name}: a shot of role {self.role} needs a target; name one of the [target] tables")
        if self.photons_per_pixel is not None and not self.photons_per_pixel >= 0:
            raise InputError(f"shot {self.name}: photons_per_pixel is {self.photons_per_pixel}; it needs 0 or more")
        if not self.setup:
            object.__setattr__(self, "setup", self.name)
        if self.window is not None and not isinstance(self.window, Window):
            object.__setattr__(self, "window", Window.of(self.window))

    @cached_property
    def seen(self) -> str:
        """SHA-256 of all that decides what is seen in a given light (not frames, files or name)."""
        known = (self.role, self.exposure, self.light_level, self.rotation_deg, self.window, self.target, self.focus_um)
        return content_hash((known, self.distance_m, self.levels_only))

    @cached_property
    def of_one_frame(self) -> Shot:
        """The same with one frame."""
        return replace(self, frames=1)


@dataclass(frozen=True, eq=False, repr=False)
class Campaign:
    """A plan and, per shot, its captures (frame index = position; none at all: a plan).

    ``captures`` hands them out by the shot's name, ``captures["flat_03"]``; files are opened then and not before.

    ``sensor`` is the full sensor that windows refer to; ``camera`` the path of the model file that
    the plan names, if any.  Shots are taken in their order; ``taken_after`` holds, by name, those that were taken straight
    before a shot and are left out here.
    """

    name: str
    shots: tuple[Shot, ...]
    captures: Captures = field(default_factory=MemoryCaptures)
    lights: Mapping[str, Light] = field(default_factory=dict)
    nuisances: tuple[Nuisance, ...] = ()
    sensor: Sensor | None = None
    camera: str = ""
    folder: Path | None = None
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    taken_after: Mapping[str, Shot] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if isinstance(self.captures, dict) and not isinstance(self.captures, MemoryCaptures):  # frames by shot, plainly
            object.__setattr__(self, "captures", MemoryCaptures(self.captures))
        names = [shot.name for shot in self.shots]
        if len(set(names)) != len(names):
            twice = sorted(name for name, count in Counter(names).items() if count > 1)
            raise InputError(f"campaign {self.name}: two shots are called {twice[0]!r}; give each shot its own name")
        for shot in self.shots:
            if shot.light is not None and shot.light not in self.lights:
                known = ", ".join(self.lights) or "none"
                raise InputError(f"shot {shot.name}: light {shot.light!r} is not described; the campaign has: {known}")
            if shot.repeat_of is not None and shot.repeat_of not in names:
                raise InputError(f"shot {shot.name}: repeat_of names {shot.repeat_of!r}, which is no shot of this campaign")

    def __repr__(self) -> str:
        roles = Counter(shot.role for shot in self.shots)
        said = ", ".join(f"{count} {role}" for role, count in roles.items())
        kind = "a plan" if self.is_plan else "with captures"
        return f"Campaign({self.name}: {len(self.shots)} shots ({said}), sessions {', '.join(self.sessions)}, {kind})"

    @property
    def is_plan(self) -> bool:
        """Whether no shot has captures or given metrics."""
        return not any(shot.name in self.captures or shot.given is not None for shot in self.shots)

    @property
    def sessions(self) -> tuple[str, ...]:
        """Measurement sessions, in order of appearance."""
        return tuple(dict.fromkeys(shot.measurement_session for shot in self.shots))

    def only(self, names: Iterable[str]) -> Campaign:
        """The campaign with only the named shots (references to left-out repeats are dropped)."""
        wanted = set(names)
        shots = tuple(
            replace(shot, repeat_of=shot.repeat_of if shot.repeat_of in wanted else None)
            for shot in self.shots
            if shot.name in wanted
        )
        before = {shot.name: self.before(shot) for shot in shots}
        gone = {name: shot for name, shot in before.items() if shot is not None and shot.name not in wanted}
        return replace(self, shots=shots, captures=self.captures.only(wanted), taken_after=gone)

    def before(self, shot: Shot) -> Shot | None:
        """The shot that was taken straight before another, None before the first."""
        place = next(i for i, own in enumerate(self.shots) if own.name == shot.name)
        return self.taken_after.get(shot.name, self.shots[place - 1] if place else None)

    def session(self, name: str) -> Campaign:
        """One measurement session."""
        return self.only(shot.name for shot in self.shots if shot.measurement_session == name)

    def as_plan(self) -> Campaign:
        """The campaign without its captures."""
        return replace(self, captures=MemoryCaptures())

    def unknowns(self) -> tuple[Parameter, ...]:
        """Every value that the laboratory does not know exactly, once for all shots that share it.

        What changes from frame to frame and what rows alone have is left out: it is marginalised, not fitted.
        """
        return self._unknowns

    @cached_property
    def _unknowns(self) -> tuple[Parameter, ...]:
        out: dict[str, Parameter] = {}
        for prior in self.nuisances:
            if prior.marginalised:
                continue
            for shot in self.shots if prior.of_camera else (s for s in self.shots if prior.applies_to(s)):
                out |= {parameter.label: parameter for parameter in prior.unknowns_of(shot)}
        return tuple(out.values())

    def nuisances_of(self, shot: Shot) -> tuple[tuple[str, str], ...]:
        """Names and labels of the nuisances that act on a shot's light, not on its frames, the camera or given rows."""
        if shot.name not in self._of_shots:
            acting = [
                p
                for p in self.nuisances
                if not p.marginalised and not p.of_camera and p.parameter not in GIVEN_NUISANCES and p.applies_to(shot)
            ]
            self._of_shots[shot.name] = tuple((p.name, p.label) for prior in acting for p in prior.unknowns_of(shot))
        return self._of_shots[shot.name]

    def tolerances_of(self, shot: Shot) -> tuple[Parameter, ...]:
        """The camera's parameters that are not known exactly, as a shot shares them: one tuple for all shots that share them."""
        if shot.name not in self._tolerances:
            own = tuple(prior.unknown(shot) for prior in self.nuisances if prior.of_camera)
            known = (other for other in self._tolerances.values() if other == own)
            self._tolerances[shot.name] = next(known, own)
        return self._tolerances[shot.name]

    @cached_property
    def _tolerances(self) -> dict[str, tuple[Parameter, ...]]:
        return {}

    @cached_property
    def _of_shots(self) -> dict[str, tuple[tuple[str, str], ...]]:
        return {}
