"""A table in the manner of EMVA 1288 (release 4.0) from one photon-transfer series.

Names, symbols and definitions follow the standard; estimates are those of this package (weighted fits, ratio-scaled
frames, exact rounding), which is said in the note of each row that differs.  Quantum efficiency and what hangs on
photons need the photon number from a radiometer; without it those rows are nan.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from isetval.core.capture import Capture
from isetval.core.quantity import Quantity, root
from isetval.core.sensor import RoiLike
from isetval.core.shown import Shown
from isetval.measure.noise.dark_frames import dark as dark_analysis
from isetval.measure.noise.setups import sort_into_setups
from isetval.measure.noise.transfer import transfer_of_setups
from isetval.measure.noise.transfer_result import PhotonTransfer, PlaneTransfer

if TYPE_CHECKING:
    import pandas as pd


NO_PHOTONS = "needs photons_per_pixel_s or photons_per_pixel"


@dataclass(frozen=True)
class EmvaRow:
    """One quantity of one plane."""

    plane: str
    name: str
    symbol: str
    value: float
    sigma: float
    unit: str
    note: str = ""


@dataclass(frozen=True, repr=False)
class EmvaTable(Shown):
    """Rows of the table."""

    rows: tuple[EmvaRow, ...]

    def headline(self) -> str:
        """Planes and how many quantities they have."""
        planes = list(dict.fromkeys(row.plane for row in self.rows))
        return f"{len(self.rows)} quantities of {', '.join(planes) or 'no plane'}"

    def __getitem__(self, key: tuple[str, str]) -> EmvaRow:
        """Row by (plane, symbol)."""
        for row in self.rows:
            if (row.plane, row.symbol) == key:
                return row
        raise KeyError(key)

    def to_frame(self) -> pd.DataFrame:
        """One row a quantity."""
        import pandas as pd

        return pd.DataFrame([asdict(row) for row in self.rows], columns=list(EmvaRow.__dataclass_fields__))


def emva1288(
    captures: Sequence[Capture],
    roi: RoiLike | None = None,
    dark: Sequence[Capture] | None = None,
    *,
    photons_per_pixel_s: float | None = None,
    photons_per_pixel: Sequence[float | None] | None = None,
) -> EmvaTable:
    """EMVA 1288 style characterization of each plane.

    Parameters
    ----------
    captures : sequence of Capture
        Levels from dark to saturation, two or more frames each; see ``photon_transfer``.
    roi, dark
        As for ``photon_transfer``.
    photons_per_pixel_s : float, optional
        Photon irradiance in photons per pixel and second of the flats at the monitoring wavelength (light constant,
        exposure varied): gives quantum efficiency and absolute sensitivity threshold.
    photons_per_pixel : sequence of float or None, optional
        Or the mean photons per pixel of each capture; see ``photon_transfer``.
    """
    setups = sort_into_setups(captures, roi, dark)
    result = transfer_of_setups(setups, roi, photons_per_pixel=photons_per_pixel)
    rows: list[EmvaRow] = []
    for plane, transfer in result.items():
        rows += _general(plane, transfer, photons_per_pixel_s, photons_per_pixel)
        rows += _patterns(plane, transfer)
    if setups.dark:
        rows += _dark_rows(setups.frames(setups.dark), roi, result)
    return EmvaTable(tuple(rows))


def _row(plane: str, name: str, symbol: str, q: Quantity, note: str = "") -> EmvaRow:
    return EmvaRow(plane, name, symbol, q.value, q.total_sigma, q.unit, "; ".join(filter(None, (note, q.note))))


def _general(plane: str, t: PlaneTransfer, flux: float | None, photons: Sequence[float | None] | None) -> Iterable[EmvaRow]:
    gain, read = t.gain_dn_per_e, t.read_noise_e
    yield _row(plane, "overall system gain", "K", gain, "weighted fit, not a line through zero")
    yield _row(plane, "temporal dark noise", "sigma_d", read, "rounding removed exactly; read and reset noise together")
    yield _row(plane, "temporal dark noise", "sigma_y.dark", t.read_noise_dn)
    reach = reach_of(t)
    bound = "" if saturated(t) else "lower bound: no saturated level was shot"
    yield _row(plane, "saturation capacity", "mu_e.sat", reach.full_well_e, bound)
    threshold_e = reach.threshold_e
    yield _row(plane, "sensitivity threshold", "mu_e.min", threshold_e, "signal-to-noise ratio 1")
    yield _row(plane, "dynamic range", "DR", reach.dynamic_range_db)
    yield _row(plane, "maximum signal-to-noise ratio", "SNR_max", reach.snr_max_db)
    low, high = linearity_error(t, photons)
    over = f"5 to 95 % of saturation, over {'exposure time' if photons is None else 'photons'}"
    yield _row(plane, "linearity error, lowest", "LE_min", low, over)
    yield _row(plane, "linearity error, highest", "LE_max", high, over)
    efficiency = _efficiency(t, flux)
    yield _row(plane, "quantum efficiency", "eta", efficiency, "" if math.isfinite(efficiency.value) else NO_PHOTONS)
    threshold = threshold_e.over(efficiency.scaled(0.01, "1"), "photons")
    yield _row(
        plane, "absolute sensitivity threshold", "mu_p.min", threshold, "" if math.isfinite(efficiency.value) else NO_PHOTONS
    )


@dataclass(frozen=True)
class Reach:
    """From the faintest to the brightest signal of one plane, as EMVA 1288 defines them (release 4.0, section 2)."""

    full_well_e: Quantity
    threshold_e: Quantity
    dynamic_range_db: Quantity
    snr_max_db: Quantity


def saturated(t: PlaneTransfer) -> bool:
    """Whether the series reached saturation; otherwise `Reach` holds lower bounds."""
    return "saturated_levels_left_out" in t.flags


def reach_of(t: PlaneTransfer) -> Reach:
    """Saturation capacity, sensitivity threshold (signal-to-noise ratio 1), dynamic range, largest signal-to-noise ratio."""
    gain, read = t.gain_dn_per_e, t.read_noise_e
    capacity = saturation_level(t).over(gain, "e-")
    noise = math.hypot(read.value, math.sqrt(1 / 12) / gain.value)
    root_e = math.sqrt(noise**2 + 0.25)
    threshold = Quantity(root_e + 0.5, read.sigma * read.value / root_e, "e-")
    ratio = capacity.over(threshold, "1")
    return Reach(
        capacity,
        threshold,
        Quantity(20 * math.log10(ratio.value), 8.686 * ratio.sigma / ratio.value, "dB"),
        Quantity(10 * math.log10(capacity.value), 4.343 * capacity.sigma / capacity.value, "dB"),
    )


def saturation_level(t: PlaneTransfer) -> Quantity:
    """Mean signal of the brightest usable level, or of the plateau of the saturated ones, DN above black."""
    beyond = [level for level in t.levels if level.reason in ("clipped_at_white", "above_saturation_knee")]
    used = [level for level in t.levels if level.used]
    low = used[-1].mean_dn
    if not beyond:
        return Quantity(low, used[-1].mean_sigma_dn, "DN")
    if beyond[0].reason == "clipped_at_white":
        high = max(beyond[-1].white_dn - t.black_dn.value, low)
        return Quantity(high, 0.5, "DN")
    high = beyond[0].mean_dn
    # saturation lies between the last level below and the first one at it
    return Quantity((low + high) / 2, abs(high - low) / math.sqrt(12), "DN")


def linearity_error(t: PlaneTransfer, photons: Sequence[float | None] | None = None) -> tuple[Quantity, Quantity]:
    """Smallest and largest relative departure from the line fitted with relative weights, %.

    Over the ``photons`` of the captures where they are stated, as the standard has it, else over exposure times.
    """
    nothing = Quantity(math.nan, math.nan, "%")
    top = saturation_level(t).value
    middle = [level for level in t.levels if level.used and 0.05 * top <= level.mean_dn <= 0.95 * top]
    stated = [(level, level.time_s if photons is None else photons[level.numbers[0]]) for level in middle]
    levels = [level for level, exposure in stated if exposure]
    x = np.array([exposure for _, exposure in stated if exposure], dtype=float)
    if np.unique(x).size < 3:
        return nothing, nothing
    mean = np.array([level.mean_dn for level in levels])
    design = np.stack([x / x.max(), np.ones_like(x)], axis=1)
    theta = np.linalg.lstsq(design / mean[:, None], np.ones_like(mean), rcond=None)[0]
    error = 100 * (mean / (design @ theta) - 1)
    sigma = np.array(
        [100 * math.hypot(level.mean_sigma_dn, _jitter(level.frame_scatter, level.frames)) / level.mean_dn for level in levels]
    )
    low, high = int(np.argmin(error)), int(np.argmax(error))
    return Quantity(float(error[low]), float(sigma[low]), "%"), Quantity(float(error[high]), float(sigma[high]), "%")


def _jitter(scatter: Quantity, frames: int) -> float:
    return math.sqrt(max(scatter.value, 0.0) / frames)


def _efficiency(t: PlaneTransfer, flux: float | None) -> Quantity:
    """Quantum efficiency from stated photon numbers, else from their rate over the time that the light was on."""
    if math.isfinite(t.quantum_efficiency.value):
        return t.quantum_efficiency
    offset_s = t.exposure_offset.value if t.linearity_from == "exposure times" else 0.0
    timed = [level for level in t.levels if level.used and (level.time_s or 0.0) > offset_s]
    if not flux or not timed:
        return Quantity(math.nan, math.nan, "%")
    rate = np.array([level.mean_dn / ((level.time_s or 0.0) - offset_s) for level in timed])
    error = float(np.std(rate, ddof=1)) / math.sqrt(rate.size) if rate.size > 1 else 0.0
    return Quantity(100 * float(np.mean(rate)) / flux, 100 * error / flux, "%").over(t.gain_dn_per_e, "%")


def _patterns(plane: str, t: PlaneTransfer) -> Iterable[EmvaRow]:
    """PRNU parts at the used level nearest half saturation, % of the mean, signed."""
    used = [level for level in t.levels if level.used and level.fixed is not None]
    level = min(used, key=lambda v: abs(v.mean_dn - 0.5 * used[-1].mean_dn))
    assert level.fixed is not None
    note = "smooth light divided out"
    for name, part in (
        ("total", level.fixed.total),
        ("row", level.fixed.row),
        ("column", level.fixed.column),
        ("pixel", level.fixed.pixel),
    ):
        q = root(part.scaled((100 / level.pattern_mean_dn) ** 2, "%^2"), "%")
        symbol = "PRNU1288" + ("" if name == "total" else f".{name}")
        yield _row(plane, f"photo-response non-uniformity, {name}", symbol, q, note)
    yield _row(plane, "photo-response non-uniformity, dark pattern removed", "PRNU.pixel.all_levels", t.prnu, "all levels")


def _dark_rows(darks: Sequence[Capture], roi: RoiLike | None, result: PhotonTransfer) -> Iterable[EmvaRow]:
    for plane, d in dark_analysis(darks, roi).items():
        gain = result[plane].gain_dn_per_e
        level = d.levels[0][1]
        for name, part in (
            ("total", level.fixed.total),
            ("row", level.fixed.row),
            ("column", level.fixed.column),
            ("pixel", level.dsnu_variance),
        ):
            symbol = "DSNU1288" + ("" if name == "total" else f".{name}")
            yield _row(plane, f"dark signal non-uniformity, {name}", symbol, root(part, "DN").over(gain, "e-"))
        yield _row(plane, "dark current from the mean", "mu_c.mean", d.dark_current_dn_per_s.over(gain, "e-/s"))
        squared = Quantity(gain.value**2, 2 * gain.value * gain.sigma, "DN^2/e-")
        by_variance = d.dark_current_variance_dn2_per_s.over(squared, "e-/s")
        yield _row(plane, "dark current from the variance", "mu_c.var", by_variance)
        uneven = d.dark_current_nonuniformity_dn_per_s.over(gain, "e-/s")
        yield _row(plane, "dark current non-uniformity, pixel", "DCNU.pixel", uneven, "not of the standard")


def signal_to_noise(t: PlaneTransfer, electrons: Sequence[float]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Signal-to-noise curve SNR(mu) of one pixel with temporal noise and PRNU, (levels,)."""
    mu = np.asarray(electrons, dtype=float)
    prnu = t.prnu.value / 100 if math.isfinite(t.prnu.value) else 0.0
    noise = mu + t.read_noise_e.value**2 + 1 / 12 / t.gain_dn_per_e.value**2 + (prnu * mu) ** 2
    return np.asarray(mu / np.sqrt(noise))
