"""Smooth reflectances of the 24-patch chart from its published colours, for charts that nobody measured.

Question: how near does the smoothest spectrum of a published colour come to a real patch?
Data: CIE L*a*b* (D50) that the chart's maker published (isetval.measure.color.chart_layout.LAB_D50); color matching functions
as the multi-lobe fits of Wyman, Sloan and Shirley, J. Comput. Graph. Tech. 2 (2013); D50 of data/spectra/illuminants.csv.
Method: least squares of second differences over wavelength under the three tristimulus values and 0.01 to 0.98 (Smits,
J. Graph. Tools 4 (1999), with bounds).
Result: ``data/spectra/chart24.csv``.  Against 24 reflectances that a laboratory measured on a chart of 2016
(``--check TABLE.csv``, scaled to its white), the root mean square difference is printed for each patch.

    python analyses/chart24_reflectances.py [--check spectra.csv] [--write]
"""

# %%
from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from isetval.core.scene import read_spectra
from isetval.files.spectra_search import find_spectra
from isetval.measure.color.chart_layout import LAB_D50, PATCH_NAMES

ROOT = Path(__file__).resolve().parents[1]
GRID = np.arange(380.0, 741.0, 10.0)
LOW, HIGH = 0.01, 0.98
EXACT = 1e3  # weight of the colour against smoothness
Float = NDArray[np.float64]


# %% Color matching functions (Wyman, Sloan and Shirley 2013, table 1)
def matching(nm: Float) -> Float:
    """x, y, z (3, bands) of the CIE 1931 observer."""

    def lobe(mean: float, left: float, right: float) -> Float:
        return np.asarray(np.exp(-(((nm - mean) * np.where(nm < mean, left, right)) ** 2) / 2))

    x = 0.362 * lobe(442.0, 0.0624, 0.0374) + 1.056 * lobe(599.8, 0.0264, 0.0323) - 0.065 * lobe(501.1, 0.0490, 0.0382)
    y = 0.821 * lobe(568.8, 0.0213, 0.0247) + 0.286 * lobe(530.9, 0.0613, 0.0322)
    z = 1.217 * lobe(437.0, 0.0845, 0.0278) + 0.681 * lobe(459.0, 0.0385, 0.0725)
    return np.stack([x, y, z])


def tristimulus(lab: Float) -> Float:
    """X, Y, Z over those of the white, from L*, a*, b* (CIE 15)."""
    f = (lab[0] + 16) / 116 + np.array([lab[1] / 500, 0.0, -lab[2] / 200])
    return np.asarray(np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29)))


# %% The smoothest reflectance of each colour
def reflectances() -> Float:
    """(24, bands)."""
    light = read_spectra(ROOT / "data" / "spectra" / "illuminants.csv")["D50"].at(GRID)
    weight = matching(GRID) * light
    weight /= weight.sum(axis=1, keepdims=True)
    rough = np.diff(np.eye(GRID.size), n=2, axis=0)
    out = []
    for lab in LAB_D50:
        system = np.vstack([rough, EXACT * weight])
        wanted = np.concatenate([np.zeros(len(rough)), EXACT * tristimulus(lab)])
        out.append(lsq_linear(system, wanted, bounds=(LOW, HIGH)).x)
    return np.array(out)


def check(table: Path, mine: Float) -> None:
    """Print the distance from measured reflectances."""
    spectra = find_spectra(table.parent)
    measured = np.array([found[2].at(GRID) for name in PATCH_NAMES if (found := spectra.reflectance(name)) is not None])
    if len(measured) < len(PATCH_NAMES):
        raise SystemExit(f"{table}: not all 24 patches are named in it")
    seen = (GRID >= 420) & (GRID <= 700)
    measured = measured * mine[18, seen].mean() / measured[18, seen].mean()
    apart = mine[:, seen] - measured[:, seen]
    for name, row in zip(PATCH_NAMES, apart, strict=True):
        print(f"{name:15s} rms {np.sqrt(np.mean(row**2)):.3f}  largest {np.abs(row).max():.3f}")
    print(f"all: rms {np.sqrt(np.mean(apart**2)):.3f}; taken for greys of their luminance {_of_greys(measured[:, seen]):.3f}")


def _of_greys(measured: Float) -> float:
    grey = np.array([tristimulus(lab)[1] for lab in LAB_D50])
    return float(np.sqrt(np.mean((grey[:, None] - measured) ** 2)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", type=Path, help="CSV of measured reflectances with a column for each patch")
    parser.add_argument("--write", action="store_true", help="write data/spectra/chart24.csv")
    options = parser.parse_args()
    found = reflectances()
    if options.check:
        check(options.check, found)
    if options.write:
        lines = [
            "# Smoothest reflectances of the published colours of the 24-patch chart (CIE L*a*b* D50, averages of 2005), made by",
            "# analyses/chart24_reflectances.py; own work, BSD-3-Clause.  A real chart of 2016 lies .06 rms off (420 to 700 nm).",
            "wavelength_nm," + ",".join(PATCH_NAMES),
        ]
        lines += [",".join([f"{nm:g}", *(f"{v:.4f}" for v in found[:, i])]) for i, nm in enumerate(GRID)]
        (ROOT / "data" / "spectra" / "chart24.csv").write_text("\n".join(lines) + "\n")
