"""The edges of `slanted_edge_accuracy.py`: ways to draw a truth and a capture, and what is measured of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from isetval.measure.edge import sfr
from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture

CLEAN = {"bright_dn": 52000.0, "black_dn": 1024.0, "white_dn": 65535.0}
SNRS = (126, 53, 22, 11)

Case = Callable[[np.random.Generator], tuple[EdgeTruth, dict, str]]


def angle(rng: np.random.Generator, low: float = 2.0, high: float = 43.0) -> float:
    return float(rng.uniform(low, high) * rng.choice([-1, 1]) + rng.choice([0, 90, 180, 270]))


def airy(rng: np.random.Generator) -> EdgeBlur:
    return EdgeBlur(cutoff_cy_px=rng.uniform(0.8, 1.0))


def truth(rng: np.random.Generator, blur: EdgeBlur, low: float = 2.0, high: float = 43.0, **options: float) -> EdgeTruth:
    return EdgeTruth(blur, angle_deg=angle(rng, low, high), offset_px=rng.uniform(-3, 3), **options)


def signed(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.choice([-1, 1]) * rng.uniform(low, high))


def angle_sweep(rng: np.random.Generator) -> tuple[EdgeTruth, dict, str]:
    blur = EdgeBlur(gaussian_sigma_px=rng.uniform(0.3, 1.8), aperture_px=rng.choice([0.0, 1.0]))
    return truth(rng, blur, 1.5, 43.5), CLEAN, "G"


def rational(rng: np.random.Generator) -> tuple[EdgeTruth, dict, str]:
    slope = rng.choice([1 / 2, 1 / 3, 1 / 4, 2 / 3, 1 / 5])
    blur = EdgeBlur(gaussian_sigma_px=rng.uniform(0.3, 1.8))
    return EdgeTruth(blur, angle_deg=float(np.degrees(np.arctan(slope)) + rng.choice([0, 90, 180, 270]))), CLEAN, "G"


def diffraction(rng: np.random.Generator) -> tuple[EdgeTruth, dict, str]:
    return truth(rng, EdgeBlur(cutoff_cy_px=rng.uniform(0.6, 1.6))), CLEAN, "G"


def defocus(rng: np.random.Generator) -> tuple[EdgeTruth, dict, str]:
    return truth(rng, EdgeBlur(cutoff_cy_px=rng.uniform(0.8, 1.6), defocus_waves=rng.uniform(0.25, 1.0))), CLEAN, "G"


def curved(rng: np.random.Generator) -> tuple[EdgeTruth, dict, str]:
    return truth(rng, airy(rng), 2.0, 40.0, sagitta_px=signed(rng, 0.25, 4.0)), CLEAN, "G"


def shaded(rng: np.random.Generator) -> tuple[EdgeTruth, dict, str]:
    along, across = signed(rng, 0.1, 0.4), signed(rng, 0.1, 0.4)
    which = rng.integers(3)
    return (
        truth(rng, airy(rng), shading_along=along * (which != 1), shading_across=across * (which != 0)),
        CLEAN | {"bright_dn": 38000.0},
        "G",
    )


def noisy(snr: float) -> Case:
    def case(rng: np.random.Generator) -> tuple[EdgeTruth, dict, str]:
        return truth(rng, airy(rng)), {"snr_bright": snr}, "G"

    return case


def bayer(snr: float | None, side: int) -> Case:
    def case(rng: np.random.Generator) -> tuple[EdgeTruth, dict, str]:
        options = {"cfa": str(rng.choice(["RGGB", "BGGR", "GRBG", "GBRG"])), "shape": (side, side)}
        options |= CLEAN if snr is None else {"snr_bright": snr}
        return truth(rng, airy(rng)), options, str(rng.choice(["R", "G", "B"]))

    return case


def sized(side: int) -> Case:
    def case(rng: np.random.Generator) -> tuple[EdgeTruth, dict, str]:
        return truth(rng, airy(rng)), {"shape": (side, side), "snr_bright": 126}, "G"

    return case


def near_saturation(rng: np.random.Generator) -> tuple[EdgeTruth, dict, str]:
    return truth(rng, airy(rng)), {"bright_dn": (16383 - 256) * 0.97, "snr_bright": 126}, "G"


@dataclass(frozen=True)
class Condition:
    name: str
    case: Case
    n: int
    targets: dict[str, float]


CONDITIONS = [
    Condition("clean, 1.5-43.5 deg, sigma 0.3-1.8 px", angle_sweep, 100, {"worst": 0.10, "curve_p95": 0.001}),
    Condition("clean, rational slopes", rational, 40, {"worst": 0.10, "curve_p95": 0.001}),
    Condition("clean, diffraction", diffraction, 40, {"bias": 0.10, "curve_p95": 0.008}),
    Condition("clean, defocus 0.25-1 wave", defocus, 30, {"bias": 0.2, "p95": 0.5, "curve_p95": 0.008}),
    Condition("clean, curved 0.25-4 px", curved, 40, {"bias": 0.3, "sd": 0.14, "curve_p95": 0.010}),
    Condition("clean, shaded 10-40 %", shaded, 50, {"bias": 0.25, "sd": 0.5, "curve_p95": 0.009}),
    Condition("Bayer, clean", bayer(None, 100), 40, {"sd": 0.6, "curve_p95": 0.012}),
    Condition("Bayer, 160 px, SNR 53", bayer(53, 160), 60, {"sd": 2.3, "curve_p95": 0.040}),
    *[
        Condition(f"SNR {snr}", noisy(snr), 120, {"sd": sd, "bias": bias, "curve_p95": p95})
        for snr, sd, bias, p95 in zip(
            SNRS, (0.37, 1.0, 1.4, 3.9), (0.3, 0.4, 0.6, 1.0), (0.008, 0.016, 0.035, 0.075), strict=True
        )
    ],
    Condition("side 40 px, SNR 126", sized(40), 40, {"sd": 0.6}),
    Condition("side 60 px, SNR 126", sized(60), 40, {"sd": 0.45}),
    Condition("side 400 px, SNR 126", sized(400), 10, {"sd": 0.13}),
    Condition("97 % of full scale, SNR 126", near_saturation, 40, {"sd": 0.35}),
]


@dataclass(frozen=True)
class Draws:
    """MTF50 error (%), stated sigma (%), curve error, angle and blur of every edge; how many were refused."""

    error: np.ndarray
    sigma: np.ndarray
    curve: np.ndarray
    angle: np.ndarray
    mtf50: np.ndarray
    refused: int
    first: list[float]


def run(condition: Condition, n: int, seed: int) -> Draws:
    rows, refused, first = [], 0, []
    for i in range(n):
        rng = np.random.default_rng([seed, i])
        true, options, channel = condition.case(rng)
        capture = edge_capture(true, seed=int(rng.integers(2**31)), **options)
        result = sfr(capture, None, channel)
        if i < 3:
            first.append(result.mtf50_cy_px)
        if result.flags:
            refused += 1
            continue
        f50 = true.mtf50_cy_px()
        band = (result.frequency_cy_px > 0) & (result.frequency_cy_px <= 0.5)
        curve = np.abs(result.mtf[band] - true.mtf(result.frequency_cy_px[band])).max()
        error, sigma = 100 * (result.mtf50_cy_px / f50 - 1), 100 * result.mtf50_sigma / f50
        rows.append((error, sigma, curve, true.axis_angle_deg, f50))
    return Draws(*np.array(rows).T, refused, first)


def numbers(draws: Draws) -> dict[str, float]:
    pull = draws.error / draws.sigma
    return {
        "n": len(draws.error),
        "refused": draws.refused,
        "bias": float(draws.error.mean()),
        "sd": float(draws.error.std(ddof=1)),
        "p95": float(np.quantile(np.abs(draws.error), 0.95)),
        "worst": float(np.abs(draws.error).max()),
        "curve_p95": float(np.quantile(draws.curve, 0.95)),
        "coverage": float(np.mean(np.abs(pull) < 1.96)),
        "median_sigma": float(np.median(draws.sigma)),
    }


def cramer_rao_percent(snr: float, angle_deg: float = 10.0, cutoff: float = 0.9) -> float:
    shape = (100, 100)

    def picture(values: np.ndarray) -> np.ndarray:
        dark, bright, offset, turn, cut = values
        made = EdgeTruth(EdgeBlur(cutoff_cy_px=cut), angle_deg=turn, offset_px=offset, contrast=10.0).image(shape)
        return dark + (bright - dark) * (made - 0.1) / 0.9

    start = np.array([0.1, 1.0, 0.0, angle_deg, cutoff])
    steps = np.array([1e-3, 1e-3, 1e-2, 1e-2, 1e-3])
    slopes = [(picture(start + h) - picture(start - h)) / (2 * s) for s, h in zip(steps, np.diag(steps), strict=True)]
    variance = (0.1 + 0.9 * picture(start)) / snr**2
    jacobian = np.array([s.ravel() / np.sqrt(variance.ravel()) for s in slopes])
    covariance = np.linalg.inv(jacobian @ jacobian.T)
    gain = (
        EdgeBlur(cutoff_cy_px=cutoff + 1e-3).mtf50_cy_px(angle_deg) - EdgeBlur(cutoff_cy_px=cutoff - 1e-3).mtf50_cy_px(angle_deg)
    ) / 2e-3
    return float(100 * gain * np.sqrt(covariance[4, 4]) / EdgeBlur(cutoff_cy_px=cutoff).mtf50_cy_px(angle_deg))
