"""Integrals over the common area of two circular pupils: transfer functions with defocus and aberrations (see `pupil`)."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


@lru_cache(maxsize=64)
def _nodes(count: int) -> tuple[Float, Float]:
    """Gauss-Legendre nodes and weights on (0, 1)."""
    x, w = np.polynomial.legendre.leggauss(count)
    return (x + 1) / 2, w / 2


def _count(largest_phase: float) -> int:
    return min(400, 4 * math.ceil((14 + 0.7 * largest_phase) / 4))


def defocused(separation: Float, phase: Float) -> Float:
    """OTF of a defocused circular pupil; ``phase`` is a = pi z f / N."""
    s, a = np.broadcast_arrays(separation, phase)
    inside = s < 1
    if not np.any(a):
        v = np.minimum(s, 1)
        return np.asarray(2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v**2)))
    if not np.any(s):
        from scipy.special import j1

        safe = np.where(np.abs(a) < 1e-4, 1.0, a)
        return np.asarray(np.where(np.abs(a) < 1e-4, 1 - a**2 / 8, 2 * j1(safe) / safe))
    out = np.zeros(s.shape)
    out[inside] = _hopkins(s[inside], a[inside])
    return out


def _hopkins(s: Float, a: Float, across: Float | None = None) -> Float:
    """(4/pi) int cos(across v) sin(a X)/a dv by Gauss-Legendre in t, v = sin t; arguments are (n,)."""
    limit = np.arccos(s)
    total = np.zeros_like(s)
    a = np.maximum(np.abs(a), 1e-7)
    size = a * (1 - s) if across is None else (a + np.abs(across)) * (1 - s)
    for node, weight in zip(*_nodes(_count(float(size.max(initial=0)))), strict=True):
        cosine = np.cos(limit * node)
        strip = weight * cosine * np.sin(a * (cosine - s))
        total += strip if across is None else strip * np.cos(across * np.sin(limit * node))
    return np.asarray(4 / np.pi * limit * total / a)


def aberrated(separation: Float, *phases: Any) -> NDArray[Any]:
    """OTF with defocus, astigmatism, spherical aberration and coma.

    ``phases`` are the coefficients of u, of v, of the spherical term, of coma along and aside, and of the secondary spherical.
    """
    s, *terms = np.broadcast_arrays(separation, *phases)
    inside = s < 1
    out = np.zeros(s.shape, complex)
    out[inside] = _integral(s[inside], *(term[inside] for term in terms))
    return out


def _integral(
    s: Float, focus: Float, across: Float, spherical: Float, along: Float, aside: Float, secondary: Float
) -> NDArray[Any]:
    """Quadrature over the common area of two unit circles at +-s, arguments (n,).

    Of Z22 = sqrt(7) (20 rho^6 - 30 rho^4 + 12 rho^2 - 1), W(u + s, v) - W(u - s, v) is 48 sqrt(7) u s times 5 q^2 - 5 q + 1 +
    (20/3) u^2 s^2, q = u^2 + v^2 + s^2: as for Z11, of which it is 24 sqrt(5) u s (2 q - 1), an odd polynomial in u.
    """
    if not (np.any(spherical) or np.any(along) or np.any(aside) or np.any(secondary)):
        return _hopkins(s, focus, across)
    spherical, along, aside = 24 * 5**0.5 * spherical, 8**0.5 * along, 12 * 8**0.5 * aside
    secondary = 48 * 7**0.5 * secondary
    size = (np.abs(focus) + np.abs(across) + np.abs(spherical) + 14 * np.abs(along) + np.abs(aside)) * (1 - s)
    size += 2 * np.abs(secondary) * (1 - s)
    rule = _quadrant if not (np.any(along) or np.any(aside)) else _whole
    out = np.zeros(s.shape, complex)
    limits = (0.0, 6.0, 16.0, 36.0, 76.0, math.inf)
    for low, high in pairwise(limits):
        part = (size >= low) & (size < high)
        if part.any():
            count = _count(min(high, float(size[part].max()), 150.0))
            terms = (focus, across, spherical, along, aside, secondary)
            out[part] = rule(count, s[part], *(term[part] for term in terms))
    return out


def _odd_slope(g: Float, s: Float, secondary: Float) -> Callable[[Float], Float | float]:
    """What secondary spherical aberration adds to (odd phase) / u, by u^2, where v^2 + s^2 = g; nothing where there is none."""
    if not np.any(secondary):
        return lambda square: 0.0
    constant, linear = secondary * (5 * g * g - 5 * g + 1), secondary * (10 * g - 5 + 20 / 3 * s * s)
    return lambda square: constant + square * (linear + 5 * secondary * square)


def _quadrant(
    count: int, s: Float, focus: Float, across: Float, spherical: Float, _along: Float, _aside: Float, secondary: Float
) -> Float:
    """Without coma the phase is odd in u and even in v but for ``across`` v: one quadrant is enough."""
    limit = np.arccos(s)
    total = np.zeros(s.shape)
    for t, weight_t in zip(*_nodes(count), strict=True):
        v, cosine = np.sin(limit * t), np.cos(limit * t)
        reach = cosine - s
        straight = focus + spherical * (2 * (v * v + s * s) - 1)
        more = _odd_slope(v * v + s * s, s, secondary)
        strip = np.zeros(s.shape)
        for x, weight_x in zip(*_nodes(count), strict=True):
            u = reach * x
            strip += weight_x * np.cos(u * (straight + 2 * spherical * u * u + more(u * u)))
        total += weight_t * cosine * reach * strip * np.cos(across * v)
    return np.asarray(4 / np.pi * limit * total)


def _whole(
    count: int, s: Float, focus: Float, across: Float, spherical: Float, along: Float, aside: Float, secondary: Float
) -> NDArray[Any]:
    """All of the common area; what is odd in u leaves its cosine, at nodes that lie as far on both sides."""
    limit = np.arccos(s)
    nodes, weights = _nodes(count)
    total = np.zeros(s.shape, complex)
    for t, weight_t in zip(2 * nodes - 1, 2 * weights, strict=True):
        v, cosine = np.sin(limit * t), np.cos(limit * t)
        reach = cosine - s
        constant = across * v + along * (6 * (v * v + s * s) - 4)
        straight = focus + spherical * (2 * (v * v + s * s) - 1) + aside * v
        more = _odd_slope(v * v + s * s, s, secondary)
        real, imaginary = np.zeros(s.shape), np.zeros(s.shape)
        for x, weight_x in zip(2 * nodes[count // 2 :] - 1, 4 * weights[count // 2 :], strict=True):
            u = reach * x
            odd = weight_x * np.cos(u * (straight + 2 * spherical * u * u + more(u * u)))
            even = constant + 18 * along * u * u
            real += odd * np.cos(even)
            imaginary += odd * np.sin(even)
        total += weight_t * cosine * reach * (real + 1j * imaginary)
    return np.asarray(limit * total / np.pi)
