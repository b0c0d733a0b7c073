"""A metric against time: its band, its drift, and the captures that left the limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.app.archive.dataset import TABLE, Archive, _quoted
from isetval.core.errors import InputError
from isetval.core.quantity import Quantity

Float = NDArray[np.float64]
BAND_SIGMAS = 3.0  # one capture in 370 of an even series leaves such a band
MAD_TO_SIGMA = 1.4826  # of a normal distribution
SECONDS_A_YEAR = 365.25 * 86400.0
EPOCH = datetime(2000, 1, 1)  # any: only differences count
LEAST_FOR_BAND = 5  # captures: below, a median and a spread say nothing of the next one


@dataclass(frozen=True, eq=False)
class Trend:
    """One metric of one body and channel, in order of time.

    ``low`` and ``high`` are the limits; ``own_band`` says that they are the series' own: median -+ 3 times its robust spread,
    each capture's sigma added.  ``drift_per_year`` is the weighted slope, in the metric's unit.
    """

    metric: str
    body: str
    channel: str
    unit: str
    files: tuple[str, ...]
    dates: tuple[datetime | None, ...]
    values: Float
    sigmas: Float
    low: Float
    high: Float
    own_band: bool
    center: float
    spread: float
    drift_per_year: Quantity | None

    @property
    def outside(self) -> list[int]:
        """Numbers of the captures that left the limits."""
        return [int(i) for i in np.flatnonzero((self.values < self.low) | (self.values > self.high))]


def trend_of(
    archive: Archive,
    metric: str,
    *,
    channel: str = "",
    body: str = "",
    where: str = "",
    low: float | None = None,
    high: float | None = None,
) -> list[Trend]:
    """The trends of a metric, one for each body and channel.

    Parameters
    ----------
    archive : Archive
    metric : str
        Name, as ``mtf50``.
    channel, body : str
        Only these.
    where : str
        A further condition in SQL.
    low, high : float, optional
        Limits; without them the series' own band.

    Raises
    ------
    InputError
        If nothing in the archive fits.
    """
    conditions = [f"metric = {_quoted(metric)}", "value IS NOT NULL", *([f"({where})"] if where else [])]
    conditions += [f"{name} = {_quoted(said)}" for name, said in (("channel", channel), ("body", body)) if said]
    _, rows = archive.query(
        "SELECT coalesce(body, ''), coalesce(channel, ''), coalesce(unit, ''), coalesce(file, ''), date, value, "
        "coalesce(sigma, 0) "
        f'FROM {TABLE} WHERE {" AND ".join(conditions)} ORDER BY 1, 2, date NULLS FIRST, 4, record, "row"'
    )
    if not rows:
        _, known = archive.query(f"SELECT metric, count(*) FROM {TABLE} GROUP BY 1 ORDER BY 2 DESC LIMIT 20")
        names = ", ".join(str(name) for name, _ in known)
        raise InputError(f"{archive.folder}: no row of {metric!r} fits; it holds most of: {names}")
    groups: dict[tuple[str, str, str], list[tuple[Any, ...]]] = {}
    for row in rows:
        groups.setdefault(row[:3], []).append(row[3:])
    return [_trend(metric, *key, own, low, high) for key, own in groups.items()]


def _trend(
    metric: str, body: str, channel: str, unit: str, rows: Sequence[tuple[Any, ...]], low: float | None, high: float | None
) -> Trend:
    files, dates, values, sigmas = zip(*rows, strict=True)
    value, sigma = np.array(values, float), np.array(sigmas, float)
    center = float(np.median(value))
    spread = MAD_TO_SIGMA * float(np.median(np.abs(value - center)))
    own = low is None and high is None
    if own and len(value) >= LEAST_FOR_BAND:
        half = BAND_SIGMAS * np.hypot(_beyond_errors(spread, sigma), sigma)
        below, above = center - half, center + half
    else:
        below = np.full(value.shape, -np.inf if low is None else low)
        above = np.full(value.shape, np.inf if high is None else high)
    drift = _drift(dates, value, sigma, spread)
    return Trend(metric, body, channel, unit, files, dates, value, sigma, below, above, own, center, spread, drift)


def _beyond_errors(spread: float, sigma: Float) -> float:
    """The part of a robust spread that the captures' own errors do not explain."""
    return float(np.sqrt(max(spread**2 - float(np.median(sigma)) ** 2, 0.0)))


def _drift(dates: Sequence[datetime | None], value: Float, sigma: Float, spread: float) -> Quantity | None:
    """Weighted slope per year with its error; None where fewer than three captures have different times."""
    known = np.array([d is not None for d in dates])
    time_s = np.array([(d - EPOCH).total_seconds() if d is not None else np.nan for d in dates])
    if known.sum() < 3 or np.ptp(time_s[known]) == 0:
        return None
    years = (time_s[known] - time_s[known].mean()) / SECONDS_A_YEAR
    variance = _beyond_errors(spread, sigma) ** 2 + sigma[known] ** 2
    weight = 1 / np.where(variance > 0, variance, 1.0)
    centered = years - np.average(years, weights=weight)
    information = float((weight * centered**2).sum())
    slope = float((weight * centered * value[known]).sum()) / information
    return Quantity(slope, information**-0.5 if (variance > 0).all() else float("nan"), "1/yr")
