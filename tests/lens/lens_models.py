"""Lenses with closed-form answers."""

from __future__ import annotations

import numpy as np

from isetval.lens.pass_region import CircleRegion, PassRegion
from isetval.lens.polynomials import OutputPolynomial, RayPolynomials
from isetval.lens.ray_transfer import RayTransferLens
from isetval.lens.tracing import WavelengthTable


def linear(terms: dict[tuple[int, int, int], float]) -> OutputPolynomial:
    """A polynomial from a mapping of powers to coefficients."""
    return OutputPolynomial(np.array(list(terms), dtype=np.int64), np.array(list(terms.values())))


R, DX, DY, ONE = (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0)


def lens_of(outputs: dict[str, dict[tuple[int, int, int], float]], region: PassRegion, input_offset_mm: float) -> RayTransferLens:
    """A lens without thickness from its transverse terms."""
    terms = {"outx": {ONE: 0.0}, "outz": {ONE: 0.0}, "outdz": {ONE: 1.0}, **outputs}
    polynomials = RayPolynomials({name: linear(t) for name, t in terms.items()})
    return RayTransferLens("model", 0.0, input_offset_mm, 0.0, (WavelengthTable(550.0, region, polynomials),))


def thin_lens_terms(focal_mm: float) -> dict[str, dict[tuple[int, int, int], float]]:
    """From the focal plane to the lens: position q + f d, direction -q/f; exact for far objects (abbe sine lens)."""
    return {
        "outx": {DX: focal_mm},
        "outy": {R: 1.0, DY: focal_mm},
        "outdx": {DX: 0.0},
        "outdy": {R: -1 / focal_mm},
    }


def thin_lens(focal_mm: float, f_number: float) -> RayTransferLens:
    """Thin lens with a round stop in it; the input plane is the focal plane."""
    region = CircleRegion(np.array([focal_mm / f_number / 2]), np.array([0.0]), focal_mm)
    return lens_of(thin_lens_terms(focal_mm), region, focal_mm)


def fixed_pupil(radius_mm: float, distance_mm: float) -> RayTransferLens:
    """No refraction at all: a round hole of the given radius at a distance from the film (the input plane)."""
    region = CircleRegion(np.array([radius_mm]), np.array([0.0]), distance_mm)
    straight = {"outy": {R: 1.0}, "outdx": {DX: 1.0}, "outdy": {DY: 1.0}}
    return lens_of(straight, region, 0.0)
