"""Photon transfer: conversion gain, read noise, PRNU and the bends of the curve, per colour plane."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from isetval.core.capture import Capture, Roi, planes_of
from isetval.core.errors import InputError, MeasurementError
from isetval.core.quantity import Quantity
from isetval.measure.noise.curve import Anchor, CurveFit, Points, Response, fit_curve, fit_response
from isetval.measure.noise.grouping import Groups, group
from isetval.measure.noise.levels import Level, LevelSeries, cut_series, measure_levels
from isetval.measure.noise.lyu2022 import single_level_gain
from isetval.measure.noise.offcurve import chosen, settle
from isetval.measure.noise.passes import Passes
from isetval.measure.noise.reference import DarkLevel, dark_level
from isetval.measure.noise.statistics import PlaneStatistics

if TYPE_CHECKING:
    import pandas as pd

NAN = float("nan")
NOTHING = Quantity(NAN, NAN)
METHODS = ("default", "lyu2022")
JUMP = 0.08
Extra = tuple[Mapping[str, Any], dict[int, PlaneStatistics], Passes]
CORRELATED = 0.05


@dataclass(frozen=True, eq=False)
class PlaneTransfer:
    """Photon transfer of one colour plane.

    Parameters
    ----------
    gain_dn_per_e : Quantity
        Conversion gain K, DN/e-; sigma covers the choice of terms, not ``cut_spread``.
    read_noise_e, read_noise_dn : Quantity
        Temporal dark noise of a pixel (read and reset noise together) without rounding.
    prnu : Quantity
        Pixel-to-pixel photo-response non-uniformity, % (smooth shading and row / column parts taken out).
    dsnu_e : Quantity
        Pixel-to-pixel dark offset, e- (from dark frames).
    black_dn : Quantity
        Black level used, raw DN.
    quadratic : Quantity
        c of V = V0 + K m + c m^2 after straightening, where that was possible.
    nonlinearity : Quantity
        Departure of the mean from a straight line at the highest level used, from exposure times (1 = all of it).
    brighter_fatter_per_e : Quantity
        A of V = mu (1 - A mu), 1/e-: -c, once the means are known to be straight or were straightened; else nan.
    neighbor_covariance_per_e : Quantity
        Sum of the covariances with the four nearest mosaic neighbours over the squared mean, 1/e-.
    saturation_cut_dn : float
        Highest mean used, DN above black.
    cut_spread : float
        Relative range of K when the series is cut at 50, 70 and 100 % of that: a systematic error.
    flags : tuple of str
        Reason codes; empty = nothing to report.
    """

    plane: str
    gain_dn_per_e: Quantity
    read_noise_e: Quantity
    read_noise_dn: Quantity
    prnu: Quantity
    dsnu_e: Quantity
    black_dn: Quantity
    quadratic: Quantity = NOTHING
    nonlinearity: Quantity = NOTHING
    brighter_fatter_per_e: Quantity = NOTHING
    neighbor_covariance_per_e: Quantity = NOTHING
    saturation_cut_dn: float = NAN
    cut_spread: float = NAN
    chi2: float = NAN
    dof: int = 0
    levels: tuple[Level, ...] = ()
    flags: tuple[str, ...] = ()
    fit: CurveFit | None = None
    choices: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PhotonTransfer(Mapping[str, PlaneTransfer]):
    """Plane name -> PlaneTransfer, with what was chosen from the data."""

    planes: Mapping[str, PlaneTransfer]
    method: str
    notes: tuple[str, ...] = ()

    def __getitem__(self, plane: str) -> PlaneTransfer:
        if plane not in self.planes:
            raise InputError(f"plane {plane!r} was not measured; there are {', '.join(self.planes)}")
        return self.planes[plane]

    def __iter__(self) -> Iterator[str]:
        return iter(self.planes)

    def __len__(self) -> int:
        return len(self.planes)

    @property
    def choices(self) -> Mapping[str, Any]:
        """What was chosen from the data, by plane; give it to a second run as ``choices``."""
        return {name: plane.choices for name, plane in self.planes.items()}

    def to_frame(self) -> pd.DataFrame:
        """One row a quantity: plane, name, value, sigma, unit, flags, note."""
        import pandas as pd

        rows = []
        for plane, result in self.planes.items():
            for name, value in vars(result).items():
                if isinstance(value, Quantity):
                    flags = " ".join(result.flags)
                    rows.append((plane, name, value.value, value.total_sigma, value.unit, flags, value.note))
        return pd.DataFrame(rows, columns=["plane", "name", "value", "sigma", "unit", "flags", "note"])


def photon_transfer(
    captures: Sequence[Capture],
    roi: Roi | None = None,
    dark: Sequence[Capture] | None = None,
    *,
    method: str = "default",
    choices: Mapping[str, Any] | None = None,
) -> PhotonTransfer:
    """Conversion gain and noise from frames of evenly lit fields.

    Parameters
    ----------
    captures : sequence of Capture
        Two or more frames at each of one or more levels, and darks unless given apart.
    roi : (row0, row1, col0, col1), optional
        Region on the mosaic, the same for all.
    dark : sequence of Capture, optional
        Dark frames.  Without them the captures at the shortest time whose mean is at black are taken.
    method : {"default", "lyu2022"}
        ``lyu2022`` is the single-level estimator of Lyu et al. (2022), appendix on conversion gain, applied to the
        brightest unsaturated level.
    choices : mapping, optional
        ``choices`` of an earlier result: its saturation cut and model weights are used again.

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
    V(m) = V0 + K m + c m^2 with the temporal variance V of scaled frames (see ``moments``), Janesick (2007).
    """
    if method not in METHODS:
        raise InputError(f"method is {method!r}; it needs one of {', '.join(METHODS)}")
    groups = group(captures, roi, dark)
    known: dict[int, PlaneStatistics] = {}
    passes = _passes(groups, roi)
    planes = {
        plane: _plane_transfer(groups, plane, roi, method, (dict((choices or {}).get(plane, {})), known, passes))
        for plane in planes_of(groups.flats[0][0])
    }
    return PhotonTransfer(planes, method, groups.notes)


def _passes(groups: Groups, roi: Roi | None) -> Passes:
    """One pass over all frames, the darks first: they say where black is."""
    passes = Passes(roi)
    if len(groups.dark) > 1:
        means = {plane: float(sums.row_means.mean()) for plane, sums in passes.of(groups.dark).items()}
        passes = Passes(roi, means, passes.found)
    passes.prepare(groups.flats)
    return passes


def _plane_transfer(groups: Groups, plane: str, roi: Roi | None, method: str, extra: Extra) -> PlaneTransfer:
    choices, _, passes = extra
    dark_sums = passes.of(groups.dark)[plane] if len(groups.dark) > 1 else None
    reference = dark_level(groups.dark, plane, roi, sums=dark_sums) if groups.dark else None
    series = measure_levels(groups.flats, plane, roi, reference, passes)
    series, flags = cut_series(series, choices.get("cut_dn"))
    flags = (*groups.notes, *(reference.flags if reference else ()), *flags)
    if not any(level.used for level in series.levels):
        reasons = ", ".join(sorted({level.reason for level in series.levels}))
        raise MeasurementError(
            f"plane {plane}: none of {len(series.levels)} levels is usable ({reasons}); photon transfer needs a lit level "
            "below saturation: shorten the exposure"
        )
    if method == "lyu2022":
        return _lyu2022(series, reference, plane, flags, roi)
    return _default(series, reference, plane, flags, extra, roi)


def _anchor(reference: DarkLevel | None, series: LevelSeries) -> Anchor | None:
    if reference is None or not math.isfinite(reference.read_variance.value):
        return None
    rounded = reference.rounded_variance
    return Anchor(rounded.value, max(rounded.sigma, 1e-4), reference.black_dn.sigma)


def _default(
    series: LevelSeries,
    reference: DarkLevel | None,
    plane: str,
    flags: tuple[str, ...],
    extra: Extra,
    roi: Roi | None,
) -> PlaneTransfer:
    from isetval.measure.noise.bends import covariance_per_e, nonlinearity_at
    from isetval.measure.noise.response import prnu_percent

    choices, known, _ = extra
    anchor = _anchor(reference, series)
    used = [level for level in series.levels if level.used]
    if anchor is None and len(used) < 2:
        return _one_level_without_dark(series, reference, plane, flags, roi)

    def fit_of(part: LevelSeries) -> CurveFit:
        response = _response([level for level in part.levels if level.used])
        full = part.range_dn
        return fit_curve(part.points(), anchor, full_scale_dn=full, response=response, weights=choices.get("weights"))

    series, fit, more = settle(series, fit_of, choices)
    flags += more
    points, used = series.points(), [level for level in series.levels if level.used]
    response = _response(used)
    gain = Quantity(fit.gain, fit.gain_sigma, "DN/e-")
    if not gain.value > 0:
        raise MeasurementError(
            f"plane {plane}: the variance does not rise with the mean (K = {gain}); the frames look clipped, smoothed or not raw"
        )
    if "poor_fit" in more:
        gain = Quantity(gain.value, gain.sigma * math.sqrt(fit.chi2 / max(fit.dof, 1)), gain.unit)
    read_dn = _read_noise_dn(fit, reference)
    flags += () if reference is not None else ("read_noise_extrapolated",)
    straight = response is not None or (_timed(used) and used[-1].mean_dn > 0)
    bend = _bend(fit, response)
    if not straight and abs(bend.value) > 3 * bend.sigma:
        flags += ("bend_of_unknown_cause",)
    neighbors = covariance_per_e(series, plane, roi, known)
    flags += _doubts(used, neighbors)
    return PlaneTransfer(
        plane=plane,
        gain_dn_per_e=gain,
        read_noise_e=_in_electrons(read_dn, gain, fit.joint),
        read_noise_dn=read_dn,
        prnu=prnu_percent(series, reference, plane, roi, response),
        dsnu_e=_dsnu_e(reference, gain),
        black_dn=series.black_dn,
        quadratic=bend,
        nonlinearity=nonlinearity_at(response, used),
        brighter_fatter_per_e=Quantity(-bend.value, bend.sigma, "1/e-") if straight else Quantity(NAN, NAN, "1/e-"),
        neighbor_covariance_per_e=neighbors,
        saturation_cut_dn=series.cut_dn,
        cut_spread=_cut_spread(points, anchor, response, fit),
        chi2=fit.chi2,
        dof=fit.dof,
        levels=series.levels,
        flags=tuple(dict.fromkeys(flags)),
        fit=fit,
        choices={"cut_dn": series.cut_dn, "weights": dict(fit.weights), "off_curve": chosen(series)},
    )


def _doubts(used: Sequence[Level], neighbors: Quantity) -> tuple[str, ...]:
    """Flags for a gain hidden between exposures, and for noise that neighbors share (smoothed or resampled data)."""
    flags: tuple[str, ...] = ()
    if _timed(used):
        rate = np.array([level.mean_dn / level.time_s for level in used if level.time_s and level.mean_dn > 5])
        if rate.size > 2 and float(np.max(np.abs(np.diff(np.log(rate))))) > JUMP:
            flags += ("means_not_linear_in_time",)
    top = used[-1]
    share = neighbors.value * top.mean_dn**2 / top.variance_dn2
    if share > CORRELATED and neighbors.value > 5 * neighbors.sigma:
        flags += ("neighbors_correlated",)
    return flags


def _bend(fit: CurveFit, response: Response | None) -> Quantity:
    """Coefficient c of the quadratic fit, or of the straightened one where the response is known; never averaged."""
    if response is not None and "straight2" in fit.fits:
        best = fit.fits["straight2"]
    elif "quadratic" in fit.fits:
        best = fit.fits["quadratic"]
    else:
        return Quantity(fit.quadratic, fit.quadratic_sigma)
    return Quantity(float(best.coefficients[2]), math.sqrt(float(best.covariance[2, 2])))


def _timed(used: Sequence[Level]) -> bool:
    times = [level.time_s for level in used]
    return None not in times and len(set(times)) == len(times) >= 5


def _response(used: Sequence[Level]) -> Response | None:
    if not _timed(used):
        return None
    times = np.array([level.time_s for level in used], dtype=float)
    return fit_response(times, np.array([level.mean_dn for level in used]), np.array([level.mean_sigma_dn for level in used]))


def _read_noise_dn(fit: CurveFit, reference: DarkLevel | None) -> Quantity:
    if reference is not None and math.isfinite(reference.read_variance.value):
        return reference.read_noise_dn
    value = fit.intercept - 1 / 12
    if value <= 0:
        return Quantity(NAN, NAN, "DN")
    return Quantity(math.sqrt(value), fit.intercept_sigma / (2 * math.sqrt(value)), "DN")


def _in_electrons(noise: Quantity, gain: Quantity, joint: float = 0.0) -> Quantity:
    """Noise over gain; ``joint`` is the covariance of the variance that the noise comes from with the gain, DN^3/e-."""
    value = noise.value / gain.value
    square = noise.total_sigma**2 + (value * gain.sigma) ** 2 - joint / gain.value
    return Quantity(value, math.sqrt(max(square, 0.0)) / gain.value, "e-", 0.0, noise.note)


def _dsnu_e(reference: DarkLevel | None, gain: Quantity) -> Quantity:
    from isetval.core.quantity import root

    if reference is None or reference.moments.frames < 2:
        return Quantity(NAN, NAN, "e-")
    return _in_electrons(root(reference.dsnu_variance, "DN"), gain)


def _cut_spread(points: Points, anchor: Anchor | None, response: Response | None, fit: CurveFit) -> float:
    """Relative range of K over cuts at 50, 70 and 100 % of the highest mean used; nan with too few levels."""
    top = float(points.mean_dn.max())
    gains = [fit.gain]
    for share in (0.5, 0.7):
        mask = points.mean_dn <= share * top
        if int(mask.sum()) >= 3:
            gains.append(fit_curve(points.take(mask), anchor, response=response, weights=fit.weights).gain)
    return (max(gains) - min(gains)) / fit.gain if len(gains) > 1 else NAN


def _one_level_without_dark(
    series: LevelSeries, reference: DarkLevel | None, plane: str, flags: tuple[str, ...], roi: Roi | None
) -> PlaneTransfer:
    """One level and no dark variance: V / m is an upper bound of K."""
    level = next(level for level in series.levels if level.used)
    gain = (level.variance_dn2 - 1 / 12) / level.mean_dn
    sigma = math.hypot(level.variance_sigma_dn2 / level.mean_dn, 0.0)
    from isetval.measure.noise.response import prnu_percent

    return PlaneTransfer(
        plane=plane,
        gain_dn_per_e=Quantity(gain, sigma, "DN/e-"),
        read_noise_e=Quantity(NAN, NAN, "e-"),
        read_noise_dn=Quantity(NAN, NAN, "DN"),
        prnu=prnu_percent(series, reference, plane, roi),
        dsnu_e=Quantity(NAN, NAN, "e-"),
        black_dn=series.black_dn,
        saturation_cut_dn=series.cut_dn,
        levels=series.levels,
        flags=tuple(dict.fromkeys((*flags, "read_noise_unknown", "gain_is_upper_bound"))),
        choices={"cut_dn": series.cut_dn},
    )


def _lyu2022(
    series: LevelSeries, reference: DarkLevel | None, plane: str, flags: tuple[str, ...], roi: Roi | None
) -> PlaneTransfer:
    from isetval.measure.noise.response import prnu_percent

    level = [level for level in series.levels if level.used][-1]
    prnu = prnu_percent(series, reference, plane, roi)
    values = int(level.pixels * level.frames)
    share = prnu.value / 100 if math.isfinite(prnu.value) and prnu.value > 0 else 0.0
    gain = single_level_gain(level.mean_dn, level.pooled_variance_dn2, share, values=values)
    return PlaneTransfer(
        plane=plane,
        gain_dn_per_e=gain,
        read_noise_e=Quantity(NAN, NAN, "e-"),
        read_noise_dn=Quantity(NAN, NAN, "DN"),
        prnu=prnu,
        dsnu_e=Quantity(NAN, NAN, "e-"),
        black_dn=series.black_dn,
        saturation_cut_dn=series.cut_dn,
        levels=series.levels,
        flags=tuple(dict.fromkeys((*flags, "read_noise_and_rounding_left_in"))),
        choices={"cut_dn": series.cut_dn},
    )
