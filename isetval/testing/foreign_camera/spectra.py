"""Lights, reflectances and quantum efficiency on a fine wavelength grid, and photons per joule."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .types import Chart, Curve, Float

WAVELENGTH_NM = np.arange(380.0, 740.1, 1.0)
STEP_NM = 1.0
H_J_S, C_M_S, K_J_K = 6.62607015e-34, 2.99792458e8, 1.380649e-23
CSV_NM = np.arange(360.0, 760.1, 1.0)  # what the laboratory's spectroradiometer delivers


def bell(wavelength_nm: Float, center: float, width: float) -> Float:
    """A Gaussian line of unit height."""
    return np.exp(-(((wavelength_nm - center) / width) ** 2) / 2)


def planck(wavelength_nm: Float, kelvin: float) -> Float:
    """Spectral shape of a black body, 1 at 560 nm."""

    def value(nm: Float | float) -> Float:
        metre = nm * 1e-9
        return metre**-5 / np.expm1(H_J_S * C_M_S / (metre * K_J_K * kelvin))

    return value(wavelength_nm) / value(560.0)


def sphere(wavelength_nm: Float) -> Float:
    """An integrating sphere behind a white LED: a blue line and a broad yellow phosphor."""
    return 0.75 * bell(wavelength_nm, 452, 14) + 0.85 * bell(wavelength_nm, 545, 55) + 0.45 * bell(wavelength_nm, 625, 45)


def lamp(wavelength_nm: Float) -> Float:
    """A halogen lamp at 2870 K."""
    return planck(wavelength_nm, 2870.0)


def sky(wavelength_nm: Float) -> Float:
    """Daylight: a 6300 K body with broad absorption dips."""
    dips = 0.10 * bell(wavelength_nm, 432, 9) + 0.06 * bell(wavelength_nm, 590, 8) + 0.08 * bell(wavelength_nm, 688, 10)
    return planck(wavelength_nm, 6300.0) * (1 - dips)


def tube(wavelength_nm: Float) -> Float:
    """A fluorescent tube: mercury and rare-earth lines of a few nm (monochromator width) on a weak ground."""
    lines = ((405, 0.25), (436, 0.9), (488, 0.45), (544, 2.2), (587, 0.5), (612, 1.9), (650, 0.2))
    return 0.12 * bell(wavelength_nm, 560, 90) + sum(h * bell(wavelength_nm, c, 5.0) for c, h in lines)


LIGHTS = {"sphere": sphere, "lamp": lamp, "sky": sky, "tube": tube}


def reflectances() -> dict[str, Curve]:
    """24 patches (name -> curve on any grid): 18 coloured sigmoids and bells, six greys."""
    out = {}
    shapes = [
        ("brown", 0.06, 0.22, 590, 35, 1), ("skin", 0.14, 0.55, 580, 45, 1), ("blue_sky", 0.33, 0.15, 540, 50, 1),
        ("foliage", 0.05, 0.16, 545, 32, 0), ("flower", 0.42, 0.22, 530, 55, 1), ("turquoise", 0.16, 0.45, 510, 48, 0),
        ("orange", 0.05, 0.6, 575, 20, 1), ("royal", 0.09, 0.33, 450, 38, 0), ("rose", 0.1, 0.58, 600, 18, 1),
        ("violet", 0.06, 0.2, 430, 40, 0), ("lime", 0.08, 0.5, 550, 55, 0), ("amber", 0.06, 0.65, 560, 24, 1),
        ("deep_blue", 0.04, 0.3, 445, 30, 0), ("grass", 0.06, 0.33, 535, 36, 0), ("red", 0.05, 0.6, 610, 16, 1),
        ("yellow", 0.06, 0.74, 515, 22, 1), ("magenta", 0.16, 0.56, 615, 28, 1), ("cyan", 0.07, 0.35, 490, 45, 0),
    ]  # fmt: skip
    for name, low, high, center, width, step in shapes:
        out[name] = _step(low, high, center, width) if step else _hump(low, high, center, width)
    for name, value in (("white", 0.88), ("grey8", 0.59), ("grey6", 0.36), ("grey5", 0.2), ("grey3", 0.09), ("black", 0.032)):
        out[name] = _hump(value, value, 550, 100)
    return out


def _step(low: float, high: float, center: float, width: float) -> Curve:
    return lambda nm: low + (high - low) / (1 + np.exp(-(nm - center) / width * 1.8))


def _hump(low: float, high: float, center: float, width: float) -> Curve:
    return lambda nm: low + (high - low) * bell(nm, center, width)


def chart_table(chart: Chart) -> Float:
    """Reflectances (surfaces, wavelengths) of a chart on the fine grid: its surround, then its patches as labels count them."""
    curves = chart.curves or reflectances()
    surround = np.full(WAVELENGTH_NM.size, chart.surround)
    return np.array([surround, *(curves[name](WAVELENGTH_NM) for name in chart.boxes)])


def read_table(path: Path) -> dict[str, Float]:
    """Columns of a CSV of numbers with remarks (#) and a header: name -> values."""
    lines = [line for line in Path(path).read_text(encoding="utf-8").splitlines() if line.strip() and line[0] != "#"]
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    return {name.strip(): table[:, i] for i, name in enumerate(lines[0].split(","))}


def write_table(path: Path, columns: Mapping[str, Float], remark: str) -> None:
    """Write ``columns`` (name -> values, the first is the wavelength) with a remark line."""
    rows = zip(*columns.values(), strict=True)
    body = "\n".join(",".join(f"{value:.8g}" for value in row) for row in rows)
    Path(path).write_text(f"# {remark}\n{','.join(columns)}\n{body}\n", encoding="utf-8")


def quantum_efficiency(path: Path) -> Float:
    """QE (3, wavelengths) on the fine grid: the table's straight lines, 0 outside."""
    table = read_table(path)
    grid = table["wavelength_nm"]
    return np.array([np.interp(WAVELENGTH_NM, grid, table[c], left=0.0, right=0.0) for c in "RGB"])


def photons_per_joule() -> Float:
    """1 / (h nu) on the fine grid."""
    return WAVELENGTH_NM * 1e-9 / (H_J_S * C_M_S)


def integrate(values: Float) -> Float:
    """Trapezoid rule over the fine grid's last axis."""
    return STEP_NM * (values.sum(axis=-1) - (values[..., 0] + values[..., -1]) / 2)
