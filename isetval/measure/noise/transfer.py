"""Photon transfer: conversion gain, read noise, PRNU and the bends of the curve, per color plane."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from isetval.core.capture import Capture, check_roi, planes_of
from isetval.core.errors import InputError, MeasurementError
from isetval.core.quantity import Quantity, root
from isetval.core.sensor import RoiLike
from isetval.core.threads import one_blas_thread
from isetval.measure.noise.curve import Anchor, CurveFit, Points, bend_coefficient, fit_curve
from isetval.measure.noise.dark_level import DarkLevel, dark_level
from isetval.measure.noise.frame_pass import frame_pass
from isetval.measure.noise.level_selection import Settled, cut_series, left_out_level, settle
from isetval.measure.noise.levels import Level, LevelSeries, measure_levels, prnu_percent, with_pattern
from isetval.measure.noise.line_moments import plane_line_moments
from isetval.measure.noise.linearity import LEAST_LEVELS, MeanResponse, mean_response, nonlinearity, quantum_efficiency
from isetval.measure.noise.lyu2022 import single_level_gain
from isetval.measure.noise.setups import Setups, sort_into_setups
from isetval.measure.noise.transfer_result import NAN, PhotonTransfer, PlaneTransfer

METHODS = ("default", "lyu2022")
JUMP = 0.08  # relative, from one level to the next: non-linear responses bend slower, hidden gains are 10 % and more
LEAST_LIGHT_DN = 5.0  # below, a black level that is .4 DN off makes a jump by itself
CORRELATED = 0.05  # of the variance: brighter-fatter reaches 2 % at full well, smoothing starts at 10 %
COVARIANCE_SIDE = 512  # mosaic pixels: 2.6e5 pairs tell a correlation of .2 %
BRIGHT_SHARE = 0.4  # of the highest mean: repulsion grows with its square, darker levels weigh nothing
CLEAR_SD = 3.0  # one false flag in 370


@dataclass(eq=False)
class _Series:
    """The set-ups of one call and what was measured of them; neighbor covariances by level when first asked for."""

    setups: Setups
    roi: RoiLike | None
    photons: Sequence[float | None] | None
    dark: dict[str, DarkLevel]
    covariances: dict[tuple[int, ...], dict[str, Quantity]] = field(default_factory=dict)

    def photons_of(self, level: Level) -> float | None:
        """Mean photons per pixel of a level, None where one frame's is unknown."""
        if self.photons is None:
            return None
        stated = [self.photons[i] for i in level.numbers]
        return None if None in stated else float(np.mean([p for p in stated if p is not None]))


def photon_transfer(
    captures: Sequence[Capture],
    roi: RoiLike | None = None,
    dark: Sequence[Capture] | None = None,
    *,
    method: str = "default",
    choices: Mapping[str, Any] | None = None,
    photons_per_pixel: Sequence[float | None] | None = None,
) -> PhotonTransfer:
    """Conversion gain and noise from frames of evenly lit fields.

    Parameters
    ----------
    captures : sequence of Capture
        Two or more frames at each of one or more levels, and darks unless given apart.  May decode a file at every access:
        each frame is fetched once to be sorted and once to be measured (a few bright ones again), and one set-up is
        held at a time.
    roi : (row0, row1, col0, col1), optional
        Region on the mosaic, the same for all.
    dark : sequence of Capture, optional
        Dark frames, of one or several exposure times: black level and read noise are those of the shortest (and of all
        times that show no other level).  Without them the captures at the shortest time whose mean is at black are taken.
    method : {"default", "lyu2022"}
        ``lyu2022`` is the single-level estimator of Lyu et al. (2022), appendix on conversion gain, applied to the
        brightest unsaturated level.
    choices : mapping, optional
        ``choices`` of an earlier result: its saturation cut and model weights are used again.
    photons_per_pixel : sequence of float or None, optional
        Mean photons per pixel of each capture, from a radiometer: the means are then held against them, not against
        exposure times, and the quantum efficiency is given.

    Returns
    -------
    PhotonTransfer
        Mapping plane -> PlaneTransfer; a monochrome sensor has the plane ``MONO``.

    Raises
    ------
    InputError
        For frames that do not belong together or an unknown method.
    MeasurementError
        Where no level has two frames, or nothing is left below saturation.

    Notes
    -----
    V(m) = V0 + K m + c m^2 with the temporal variance V of scaled frames (see ``moments``), Janesick (2007).  Means against
    exposures tell a response that bends from charge repulsion; an exposure at which the light begins is fitted where
    they demand it; where no response can be made of them, variance against mean alone is left (``linearity_from``).
    """
    if method not in METHODS:
        raise InputError(f"method is {method!r}; it needs one of {', '.join(METHODS)}")
    if photons_per_pixel is not None and len(photons_per_pixel) != len(captures):
        raise InputError(
            f"photons_per_pixel has {len(photons_per_pixel)} entries for {len(captures)} captures; it needs one each"
        )
    setups = sort_into_setups(captures, roi, dark)
    return transfer_of_setups(setups, roi, method=method, choices=choices, photons_per_pixel=photons_per_pixel)


def transfer_of_setups(
    setups: Setups,
    roi: RoiLike | None,
    *,
    method: str = "default",
    choices: Mapping[str, Any] | None = None,
    photons_per_pixel: Sequence[float | None] | None = None,
) -> PhotonTransfer:
    """Photon transfer of captures that are sorted already; see ``photon_transfer``."""
    with one_blas_thread():
        levels, darks = _measure(setups, roi)
        series = _Series(setups, roi, photons_per_pixel, darks)
        planes = {
            plane: _plane_transfer(series, plane, levels[plane], method, dict((choices or {}).get(plane, {}))) for plane in levels
        }
    return PhotonTransfer(planes, method, setups.notes)


def _measure(setups: Setups, roi: RoiLike | None) -> tuple[dict[str, LevelSeries], dict[str, DarkLevel]]:
    """Levels and darks of all planes; the darks first: they say where black is."""
    darks, profile_black_dn = _measure_darks(setups, roi)
    return measure_levels(setups, roi, darks, profile_black_dn), darks


def _measure_darks(setups: Setups, roi: RoiLike | None) -> tuple[dict[str, DarkLevel], dict[str, float]]:
    """Plane -> dark level, and plane -> raw mean where there are two frames or more."""
    if not setups.dark:
        return {}, {}
    frames = setups.frames(setups.level_dark)
    lines = plane_line_moments(frames, roi) if len(frames) > 1 else {}
    darks = {plane: dark_level(frames, plane, roi, lines=lines.get(plane)) for plane in planes_of(frames[0])}
    return darks, {plane: float(line.row_means.mean()) for plane, line in lines.items()}


def _plane_transfer(of: _Series, plane: str, series: LevelSeries, method: str, choices: Mapping[str, Any]) -> PlaneTransfer:
    dark = of.dark.get(plane)
    series, flags = cut_series(series, choices.get("cut_dn"))
    flags = (*of.setups.notes, *(dark.flags if dark else ()), *flags)
    used = [level for level in series.levels if level.used]
    if not used:
        reasons = ", ".join(sorted({level.reason for level in series.levels}))
        raise MeasurementError(
            f"plane {plane}: none of {len(series.levels)} levels is usable ({reasons}); photon transfer needs a lit level "
            "below saturation: shorten the exposure"
        )
    if all(level.fixed is None for level in used):
        top = with_pattern(used[-1], of.setups, plane, of.roi, series.black_dn.value)
        series = series.with_level(top)
    if method == "lyu2022":
        return _lyu2022(series, dark, plane, flags)
    if _anchor(dark) is None and len(used) < 2:
        return _one_level_without_dark(series, dark, plane, flags)
    return _from_curve(of, series, plane, flags, choices)


def _anchor(dark: DarkLevel | None) -> Anchor | None:
    if dark is None or not math.isfinite(dark.read_variance.value):
        return None
    rounded = dark.rounded_variance
    return Anchor(rounded.value, max(rounded.sigma, 1e-4), dark.black_dn.sigma)  # 1e-4 DN^2: keeps the normal matrix regular


def _from_curve(
    of: _Series,
    series: LevelSeries,
    plane: str,
    flags: tuple[str, ...],
    choices: Mapping[str, Any],
) -> PlaneTransfer:
    """Gain, read noise and bends from the curve of variance against mean."""
    dark = of.dark.get(plane)
    settled, gain = _settled_fit(of, series, choices, plane)
    series, fit = settled.series, settled.fit
    used = [level for level in series.levels if level.used]
    response = _response(of, series)
    read_dn = _read_noise_dn(fit, dark)
    neighbors = _covariance_per_e(of, used, plane)
    bend = bend_coefficient(fit, straightened=response.response is not None)
    flags += (*settled.flags, *(() if dark is not None else ("read_noise_extrapolated",)))
    flags += _doubts(used, response, bend, neighbors, dark)
    return PlaneTransfer(
        plane=plane,
        gain_dn_per_e=gain,
        read_noise_e=_in_electrons(read_dn, gain, fit.joint),
        read_noise_dn=read_dn,
        prnu=prnu_percent(series, dark, response.response),
        dsnu_e=_dsnu_e(dark, gain),
        black_dn=series.black_dn,
        quadratic=bend,
        nonlinearity=nonlinearity(response, _means(used)),
        brighter_fatter_per_e=Quantity(-bend.value, bend.sigma, "1/e-") if response.known else Quantity(NAN, NAN, "1/e-"),
        neighbor_covariance_per_e=neighbors,
        quantum_efficiency=quantum_efficiency(response, _means(used), gain, [of.photons_of(level) for level in used]),
        exposure_offset=response.offset,
        linearity_from=response.basis,
        level_scatter_percent=100 * settled.scatter,
        saturation_cut_dn=series.cut_dn,
        cut_spread=_cut_spread(series.points().scattered(settled.scatter), _anchor(dark), response, fit),
        chi2=settled.chi2,
        dof=settled.dof,
        levels=series.levels,
        flags=tuple(dict.fromkeys(flags)),
        fit=fit,
        choices=_choices(settled),
    )


def _settled_fit(of: _Series, series: LevelSeries, choices: Mapping[str, Any], plane: str) -> tuple[Settled, Quantity]:
    """The curve, and the gain it gives."""
    anchor = _anchor(of.dark.get(plane))

    def fit_of(part: LevelSeries, scatter: float = 0.0) -> CurveFit:
        points, response = part.points().scattered(scatter), _response(of, part).response
        return fit_curve(points, anchor, full_scale_dn=part.range_dn, response=response, weights=choices.get("weights"))

    settled = settle(series, fit_of, choices)
    gain = Quantity(settled.fit.gain, settled.fit.gain_sigma, "DN/e-")
    if not gain.value > 0:
        raise MeasurementError(
            f"plane {plane}: the variance does not rise with the mean (K = {gain}); the frames look clipped, smoothed or not raw"
        )
    return settled, gain


def _choices(settled: Settled) -> dict[str, Any]:
    return {
        "cut_dn": settled.series.cut_dn,
        "weights": dict(settled.fit.weights),
        "off_curve": left_out_level(settled.series),
        "level_scatter": settled.scatter,
    }


def _means(used: Sequence[Level]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([level.mean_dn for level in used])


def _response(of: _Series, series: LevelSeries) -> MeanResponse:
    used = [level for level in series.levels if level.used]
    return mean_response(
        _means(used),
        np.array([level.mean_sigma_dn for level in used]),
        time_s=[level.time_s for level in used],
        photons=[of.photons_of(level) for level in used],
        black_sigma_dn=series.black_dn.total_sigma,
    )


def _doubts(
    used: Sequence[Level], response: MeanResponse, bend: Quantity, neighbors: Quantity, dark: DarkLevel | None
) -> tuple[str, ...]:
    """Flags for what the means say of light and response, and for noise that neighbors share (smoothed or resampled data)."""
    flags: tuple[str, ...] = ()
    if response.known:
        rate = response.rate(_means(used))[_means(used)[response.exposure > 0] > LEAST_LIGHT_DN]
        if rate.size > 2 and float(np.max(np.abs(np.diff(np.log(rate))))) > JUMP:
            flags += ("means_not_linear_in_time",)
        if response.offset.value:
            # without darks a black level that is off by as much would look the same
            flags += ("exposure_offset",) if dark is not None else ("exposure_offset_or_black_level",)
    else:
        known = {level.time_s for level in used if level.time_s is not None}
        flags += ("variance_against_mean_alone",) if len(known) >= LEAST_LEVELS else ()
        flags += ("bend_of_unknown_cause",) if abs(bend.value) > CLEAR_SD * bend.sigma else ()
    top = used[-1]
    share = neighbors.value * top.mean_dn**2 / top.variance_dn2
    if share > CORRELATED and neighbors.value > 5 * neighbors.sigma:
        flags += ("neighbors_correlated",)
    return flags


def _read_noise_dn(fit: CurveFit, dark: DarkLevel | None) -> Quantity:
    if dark is not None and math.isfinite(dark.read_variance.value):
        return dark.read_noise_dn
    value = fit.intercept - 1 / 12
    if value <= 0:
        return Quantity(NAN, NAN, "DN")
    return Quantity(math.sqrt(value), fit.intercept_sigma / (2 * math.sqrt(value)), "DN")


def _in_electrons(noise: Quantity, gain: Quantity, joint: float = 0.0) -> Quantity:
    """Noise over gain; ``joint`` is the covariance of the variance that the noise comes from with the gain, DN^3/e-."""
    value = noise.value / gain.value
    square = noise.total_sigma**2 + (value * gain.sigma) ** 2 - joint / gain.value
    return Quantity(value, math.sqrt(max(square, 0.0)) / gain.value, "e-", 0.0, noise.note)


def _dsnu_e(dark: DarkLevel | None, gain: Quantity) -> Quantity:
    if dark is None or dark.frames < 2:
        return Quantity(NAN, NAN, "e-")
    return _in_electrons(root(dark.dsnu_variance, "DN"), gain)


def _cut_spread(points: Points, anchor: Anchor | None, response: MeanResponse, fit: CurveFit) -> float:
    """Relative range of K over cuts at 50, 70 and 100 % of the highest mean used; nan with too few levels."""
    top = float(points.mean_dn.max())
    gains = [fit.gain]
    for share in (0.5, 0.7):
        mask = points.mean_dn <= share * top
        if int(mask.sum()) >= 3:
            gains.append(fit_curve(points.take(mask), anchor, response=response.response, weights=fit.weights).gain)
    return (max(gains) - min(gains)) / fit.gain if len(gains) > 1 else NAN


def _covariance_per_e(of: _Series, used: Sequence[Level], plane: str) -> Quantity:
    """Sum of the covariances with the four nearest neighbors over the squared mean, 1/e-.

    Charge repulsion takes A mu^2 from the variance of a pixel and gives it to the covariances with its neighbors; the
    four nearest hold part of it, so this is a lower bound of A, measured apart from the variance.
    """
    bright = [level for level in used if level.mean_dn > BRIGHT_SHARE * used[-1].mean_dn]
    bright = bright[-4:] if bright[0].pixels < COVARIANCE_SIDE**2 // 4 else bright[-2:]
    value = weight_sum = 0.0
    for level in bright:
        if not level.mean_dn > 0:
            continue
        found = _four_neighbors(of, level, plane)
        weight = (level.mean_dn**2 / found.sigma) ** 2 if found.sigma > 0 else 0.0
        value += weight * found.value / level.mean_dn**2
        weight_sum += weight
    if not weight_sum > 0:
        return Quantity(NAN, NAN, "1/e-")
    return Quantity(value / weight_sum, 1 / math.sqrt(weight_sum), "1/e-")


def _four_neighbors(of: _Series, level: Level, plane: str) -> Quantity:
    if level.numbers not in of.covariances:
        of.covariances[level.numbers] = _mosaic_covariances(of.setups.frames(level.numbers), of.roi)
    found = of.covariances[level.numbers]
    mine = [q for n, q in found.items() if plane == "MONO" or plane.lower() in n.split("_")[2:]]
    return Quantity(2 * sum(q.value for q in mine), 2 * math.sqrt(sum(q.sigma**2 for q in mine)), "DN^2")


def _mosaic_covariances(captures: Sequence[Capture], roi: RoiLike | None) -> dict[str, Quantity]:
    row0, row1, col0, col1 = check_roi(captures[0], roi)
    region = (row0, min(row1, row0 + COVARIANCE_SIDE), col0, min(col1, col0 + COVARIANCE_SIDE))
    return dict(frame_pass(captures, region, dtype=np.float32).covariances)


def _one_level_without_dark(series: LevelSeries, dark: DarkLevel | None, plane: str, flags: tuple[str, ...]) -> PlaneTransfer:
    """One level and no dark variance: V / m is an upper bound of K."""
    level = next(level for level in series.levels if level.used)
    gain = Quantity((level.variance_dn2 - 1 / 12) / level.mean_dn, level.variance_sigma_dn2 / level.mean_dn, "DN/e-")
    return _of_one_level(gain, series, dark, plane, (*flags, "read_noise_unknown", "gain_is_upper_bound"))


def _lyu2022(series: LevelSeries, dark: DarkLevel | None, plane: str, flags: tuple[str, ...]) -> PlaneTransfer:
    level = [level for level in series.levels if level.used][-1]
    prnu = prnu_percent(series, dark)
    share = prnu.value / 100 if math.isfinite(prnu.value) and prnu.value > 0 else 0.0
    gain = single_level_gain(level.mean_dn, level.pooled_variance_dn2, share, values=int(level.pixels * level.frames))
    return _of_one_level(gain, series, dark, plane, (*flags, "read_noise_and_rounding_left_in"))


def _of_one_level(
    gain: Quantity, series: LevelSeries, dark: DarkLevel | None, plane: str, flags: tuple[str, ...]
) -> PlaneTransfer:
    return PlaneTransfer(
        plane=plane,
        gain_dn_per_e=gain,
        read_noise_e=Quantity(NAN, NAN, "e-"),
        read_noise_dn=Quantity(NAN, NAN, "DN"),
        prnu=prnu_percent(series, dark),
        dsnu_e=Quantity(NAN, NAN, "e-"),
        black_dn=series.black_dn,
        saturation_cut_dn=series.cut_dn,
        levels=series.levels,
        flags=tuple(dict.fromkeys(flags)),
        choices={"cut_dn": series.cut_dn},
    )
