"""What photon transfer returns: per color plane, with a table view."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from isetval.core.errors import InputError
from isetval.core.quantity import Quantity
from isetval.core.shown import Drawn
from isetval.measure.noise.curve import CurveFit
from isetval.measure.noise.levels import Level

if TYPE_CHECKING:
    import pandas as pd

NAN = float("nan")
NOTHING = Quantity(NAN, NAN)
NO_EFFICIENCY = Quantity(NAN, NAN, "%")
NO_OFFSET = Quantity(NAN, NAN, "s")


@dataclass(frozen=True, eq=False, repr=False)
class PlaneTransfer:
    """Photon transfer of one color plane.

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
        Departure of the mean from a straight line at the highest level used, from exposures (1 = all of it).
    brighter_fatter_per_e : Quantity
        A of V = mu (1 - A mu), 1/e-: -c, once the means are known to be straight or were straightened; else nan.
    neighbor_covariance_per_e : Quantity
        Sum of the covariances with the four nearest mosaic neighbors over the squared mean, 1/e-.
    quantum_efficiency : Quantity
        Electrons per photon, %, where photon numbers were stated.
    exposure_offset : Quantity
        Exposure at which the light began, s or photons; 0 where the means do not demand one, nan where none are known.
    linearity_from : str
        What the means were held against: ``"photon numbers"``, ``"exposure times"``, or ``"none"`` (variance against mean
        alone: then a bend of the curve may be the response's or charge repulsion's).
    level_scatter_percent : float
        Relative scatter of the variances about every smooth curve beyond their sampling error (uneven converter steps,
        light that differs within pairs); 0 where the fit is not poor.
    saturation_cut_dn : float
        Highest mean used, DN above black.
    cut_spread : float
        Relative range of K when the series is cut at 50, 70 and 100 % of that: a systematic error.
    chi2, dof : float, int
        Of the best curve, with sampling errors only.
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
    quantum_efficiency: Quantity = NO_EFFICIENCY
    exposure_offset: Quantity = NO_OFFSET
    linearity_from: str = "none"
    level_scatter_percent: float = 0.0
    saturation_cut_dn: float = NAN
    cut_spread: float = NAN
    chi2: float = NAN
    dof: int = 0
    levels: tuple[Level, ...] = ()
    flags: tuple[str, ...] = ()
    fit: CurveFit | None = None
    choices: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        doubts = f", {', '.join(self.flags)}" if self.flags else ""
        return (
            f"PlaneTransfer({self.plane}: K {self.gain_dn_per_e}, read noise {self.read_noise_e}, PRNU {self.prnu}, "
            f"{len(self.levels)} levels{doubts})"
        )


@dataclass(frozen=True, eq=False, repr=False)
class PhotonTransfer(Drawn, Mapping[str, PlaneTransfer]):
    """Plane name -> PlaneTransfer, with what was chosen from the data."""

    planes: Mapping[str, PlaneTransfer]
    method: str
    notes: tuple[str, ...] = ()

    def headline(self) -> str:
        """The conversion gain of every plane."""
        return "; ".join(
            f"{name}: K {plane.gain_dn_per_e}, read noise {plane.read_noise_e}" for name, plane in self.planes.items()
        )

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
