"""Priors of a drafted campaign, and what the darks say of the camera: each with the sentence that tells how it was found."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.files.captures import FileCaptures
from isetval.files.draft_types import DraftLight, DraftPrior
from isetval.files.light_levels import LitSetup
from isetval.files.shot_grouping import ShotGroup

LEAST_FLICKER = 1e-4  # a prior of 0 would say that a lamp is perfectly steady
NARROW_QE = 1.0  # ours, a factor of two: data sheets draw a filter's curve for its middle, not for its foot
PATCH = 0.05  # ours: a colour's flank rises by 1 to 3 % per nm, tables and filters are known to some nm, paint differs by some %
PATCH_FRAME = 0.005  # ours: lamps behind filters ripple, and a patch is as even as that
LAMP = 0.3  # ours, per 100 nm: what lamps behind a band-pass filter differ by, where it leaks and inside its band
SETUP_LEVEL = 0.02  # ours: a lamp switched on again, a sphere's port opened again
LEAST_SETUP_LEVEL = 0.005
PATCH_COLOR = 0.1
"""What a channel sees of a patch beside what curves of another camera and published averages say: in D65 and A the 24 colors of
two embedded cameras (the curves of a phone and of a CCD, ours after published peaks), channel by channel without its mean, are
.074 and .080 rms apart (``tests/files/test_patch_color_prior.py``), and a real chart .06 off the averages."""
BOW_SHARE = 0.25  # of the tilt's width: ratios of black bodies 2700 to 3000 K and 5500 to 6500 K bend by .14 to .26 of their tilt
UNEVEN = 0.1  # of a tilt: of smaller ones the bend is below the 2 % that charts are lit to anyway
LEAST_DARK_DN = 0.5  # mean of a dark without an offset: fewer than half of its pixels leave code 0
DARK_SIDE_PX = 256  # 65 536 pixels give read noise to .3 %


def flicker(flats: Sequence[ShotGroup]) -> tuple[float, int] | None:
    """Relative standard deviation of the light from frame to frame, and the frames that it was found from.

    The scatter of frame means less that of their pixel noise, pooled over all flats of two frames or more.
    """
    total, dof = 0.0, 0
    for group in flats:
        if len(group.facts) < 2 or group.clipped or group.level_dn <= 0:
            continue
        means = np.array([fact.level_dn for fact in group.facts]) / group.level_dn
        noise = np.mean([fact.level_sigma_dn**2 for fact in group.facts]) / len(group.first.levels_dn) / group.level_dn**2
        total += (len(means) - 1) * (float(means.var(ddof=1)) - float(noise))
        dof += len(means) - 1
    return (math.sqrt(max(total / dof, 0.0)), dof + 1) if dof else None


def level_scatter(setups: Sequence[LitSetup], repeated: Sequence[tuple[str, str]]) -> tuple[float, int] | None:
    """Relative standard deviation of the light between set-ups that were made again, and how many pairs there are."""
    level = {setup.name: setup.level for setup in setups}
    apart = [level[a] / level[b] - 1 for a, b in repeated if a in level and b in level]
    return (math.sqrt(float(np.mean(np.square(apart))) / 2), len(apart)) if apart else None


def light_priors(
    flats: Sequence[ShotGroup],
    setups: Sequence[LitSetup],
    repeated: Sequence[tuple[str, str]],
    lights: Sequence[DraftLight],
    roles: set[str],
    bracket: tuple[float, int] | None = None,
) -> list[DraftPrior]:
    """Priors on the level, steadiness, evenness and colour of the light; ``bracket`` is the scatter of a chart's exposures."""
    scatter, steady = level_scatter(setups, repeated), flicker(flats)
    if scatter is None:
        level = (SETUP_LEVEL, "CHECK: nothing was set up twice, so this is an assumption")
    else:
        level = (max(scatter[0], LEAST_SETUP_LEVEL), f"found: scatter of {scatter[1]} set-ups that were made again")
    if steady is None and bracket is not None:
        words = f"found: scatter of {bracket[1]} pairs of exposures of one chart, per unit of exposure time"
        per_frame = (max(bracket[0], LEAST_FLICKER), words)
    elif steady is None:
        per_frame = (0.002, "CHECK: no flat has two frames, so this is an assumption")
    else:
        per_frame = (max(steady[0], LEAST_FLICKER), f"found: scatter of the means of {steady[1]} flat frames beyond pixel noise")
    lit = tuple(role for role in ("flat", "edge", "chart") if role in roles)
    if not lit:
        return []
    out = [
        DraftPrior("light_level", level[0], "relative", "set-up", level[1], lit),
        DraftPrior("light_level", per_frame[0], "relative", "frame", per_frame[1], lit),
    ]
    for axis in ("x", "y") if "flat" in roles else ():
        out.append(
            DraftPrior(f"light_tilt_{axis}", 0.01, "relative", "measurement session", "CHECK: evenness of the field", ("flat",))
        )
    words = "the level of a light whose radiance nobody stated; drop it once the spectrum is filled in"
    for light in (light for light in lights if not light.told and not light.narrow):
        out.append(DraftPrior("light_level", 0.2, "relative", "campaign", words, lit, (light.name,)))
    for light in (light for light in lights if light.narrow):
        for color in ("red", "green", "blue"):
            words = f"CHECK: {light.name}: what no camera model knows of its filters in so narrow a band"
            out.append(DraftPrior(f"qe_{color}", NARROW_QE, "relative", "campaign", words, (), (light.name,)))
        if "chart" in roles:
            words = f"CHECK: {light.name}: a patch in one picture, by ripple of the lamp and unevenness that moves by a pixel"
            out.append(DraftPrior("patch_reflectance", PATCH_FRAME, "relative", "frame", words, ("chart",), (light.name,)))
            words = f"CHECK: {light.name}: reflectances are those of a table's spot and bandwidth"
            out.append(DraftPrior("patch_reflectance", PATCH, "relative", "campaign", words, ("chart",), (light.name,)))
        if light.file:
            words = f"CHECK: {light.name}: a filter's table says nothing of the lamp behind it, whose light it leaks elsewhere"
            out.append(DraftPrior("spectrum_tilt", LAMP, "relative per 100 nm", "campaign", words, (), (light.name,)))
            out.append(DraftPrior("spectrum_bow", LAMP, "relative per (100 nm)^2", "campaign", words, (), (light.name,)))
    for light in (light for light in lights if not light.narrow):
        width = 0.2 if light.column == "E" else 0.05
        taken = "equal energy" if light.column == "E" else f"published {light.column}"
        words = f"CHECK: {light.name} is taken for {taken}; .02 once its spectrum is measured"
        out.append(DraftPrior("spectrum_tilt", width, "relative per 100 nm", "measurement session", words, (), (light.name,)))
        words = "and its bend, on the same grounds"
        bow = BOW_SHARE * width
        out.append(DraftPrior("spectrum_bow", bow, "relative per (100 nm)^2", "measurement session", words, (), (light.name,)))
    return out


def target_priors(roles: set[str], *, tilt: float | None = None, colors_known: bool = True) -> list[DraftPrior]:
    """Priors on the pose and brightness of targets, for the roles that a campaign has; ``tilt`` was read off charts."""
    out = []
    if "chart" in roles and not colors_known:
        words = "neither the camera's curves nor the chart's reflectances are known; drop it once they are filled in"
        out.append(DraftPrior("patch_color", PATCH_COLOR, "relative", "campaign", words, ("chart",)))
    if "edge" in roles:
        out += [
            DraftPrior("focus_um", 2.0, "um", "measurement session", "CHECK: how well was the focus set?", ("edge",)),
            DraftPrior("edge_shift_px", 0.3, "px", "set-up", "the pose was found in the files to about .05 px", ("edge",)),
            DraftPrior("edge_angle_deg", 0.1, "deg", "set-up", "and to about .05 degrees", ("edge",)),
            DraftPrior(
                "dark_reflectance", 0.01, "reflectance", "set-up", "the dark side was read off one of the files", ("edge",)
            ),
        ]
    if "chart" in roles:
        for axis in ("x", "y"):
            words = "CHECK: how evenly was the chart lit?"
            if tilt is not None:
                words = f"found: patches over their reflectances rise by up to {100 * tilt:.0f} % from the middle to the rim"
            width = max(0.02, tilt or 0.0)
            out.append(DraftPrior(f"target_tilt_{axis}", width, "relative", "set-up", words, ("chart",)))
            if width > UNEVEN:
                words = "light that falls off so much also bends: the square of its fall"
                out.append(DraftPrior(f"target_bow_{axis}", width**2, "relative", "set-up", words, ("chart",)))
    return out


def camera_words(darks: Sequence[ShotGroup], captures: FileCaptures) -> list[str]:
    """Black level, read noise and dark current by the darks of each visit, in sentences."""
    from isetval.measure import dark

    out = []
    for session in dict.fromkeys(group.session for group in darks):
        own = [group for group in darks if group.session == session]
        if (cut := _cut_off(own)) is not None:
            out.append(f"visit {session}: {cut}")
            continue
        window = own[0].first.window
        frames = [
            middle_of(c) for g in own if g.first.window == window for f in g.files if (c := captures.take("", f)) is not None
        ]
        try:
            planes = dark(frames)
        except InputError as error:
            out.append(f"visit {session}: the darks give no read noise: {error}")
            continue
        found: Mapping[str, list[float]] = {
            name: [q.value for p in planes if math.isfinite((q := getattr(planes[p], name)).value)]
            for name in ("read_noise_dn", "dark_current_dn_per_s", "black_level_dn")
        }
        parts = [
            f"{words} {np.mean(found[name]):.4g} {unit}"
            for name, words, unit in (
                ("black_level_dn", "black level", "DN"),
                ("read_noise_dn", "read noise", "DN"),
                ("dark_current_dn_per_s", "dark current", "DN/s"),
            )
            if found[name]
        ]
        out.append(f"visit {session}: {', '.join(parts)} (mean of the planes, from {len(frames)} dark frames)")
    return out


def _cut_off(darks: Sequence[ShotGroup]) -> str | None:
    """The sentence for darks at code 0: what is left of them is no read noise and no black level."""
    at_zero = [group for group in darks if max(group.first.levels_dn) < LEAST_DARK_DN and min(_blacks(group)) <= 0]
    if not at_zero:
        return None
    times = ", ".join(f"{t:g} s" for t in sorted({g.first.exposure.time_s or 0.0 for g in at_zero}))
    mean = max(max(g.first.levels_dn) for g in at_zero)
    return (
        f"the darks of {times} stand at code 0 (means up to {mean:.2g} DN): their noise is cut off below, so that they give no "
        "read noise and no black level; record with an offset, or state both"
    )


def _blacks(group: ShotGroup) -> tuple[float, ...]:
    return tuple(level for row in group.first.sensor.black_dn for level in row)


def middle_of(capture: Capture) -> Capture:
    """The middle of a capture: enough pixels for a noise, at its place on the sensor."""
    from dataclasses import replace

    rows, cols = (min(n, DARK_SIDE_PX) for n in capture.mosaic.shape)
    top, left = ((n - m) // 4 * 2 for n, m in zip(capture.mosaic.shape, (rows, cols), strict=True))
    part = capture.mosaic[top : top + rows, left : left + cols]
    return replace(capture, mosaic=part, window=(capture.window[0] + top, capture.window[1] + left))
