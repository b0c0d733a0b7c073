"""The closed box against an independent radiosity solution.

The solution: walls cut into squares of constant radiosity, form factors from points to squares by Lambert's
contour integral, light carried from square to square bounce by bounce, gathered at the point that a pixel sees.
"""

import numpy as np
import pytest

from isetval.core.scene import Spectrum
from isetval.scenes import cornell_box, render

pytestmark = pytest.mark.mitsuba
SIDE, CELLS, LIGHT = 0.30, 15, 0.10
ALBEDO = {"white_paper": 0.8, "red_paper": 0.5, "green_paper": 0.3}
BANDS = np.array([500.0, 600.0])  # their plain mean has no noise from the choice of wavelengths
CAMERA = {
    "position_m": [0.01, -0.02, 0.12],
    "look_at_m": [0.0, 0.0, -0.1],
    "up": [0, 1, 0],
    "focal_mm": 2.0,
    "pixel_um": 125.0,
    "rows": 48,
    "cols": 64,
}
PIXELS = [(r, c) for r in (8, 24, 40) for c in (6, 24, 40, 58)]


def walls():
    """(origin corner, edge u, edge v, albedo, emits) with normals u x v to the inside."""
    h = SIDE / 2
    x, y, z = np.eye(3) * SIDE
    low, high = np.array([-h, -h, -h]), np.array([h, h, h])
    return [
        (low, z, x, ALBEDO["white_paper"]),  # floor, normal +y
        (low + y, x, z, ALBEDO["white_paper"]),  # ceiling, normal -y
        (low, x, y, ALBEDO["white_paper"]),  # rear, normal +z
        (high, -y, -x, ALBEDO["white_paper"]),  # front, normal -z
        (low, y, z, ALBEDO["red_paper"]),  # left, normal +x
        (high, -z, -y, ALBEDO["green_paper"]),  # right, normal -x
    ]


def squares():
    corners, normals, albedo, emission = [], [], [], []
    for origin, u, v, rho in walls():
        normal = np.cross(u, v) / SIDE**2
        for i in range(CELLS):
            for j in range(CELLS):
                c = origin + u * i / CELLS + v * j / CELLS
                quad = np.array([c, c + u / CELLS, c + (u + v) / CELLS, c + v / CELLS])
                lamp = normal[1] < -0.5 and np.all(np.abs(quad.mean(axis=0)[[0, 2]]) < LIGHT / 2)
                corners.append(quad)
                normals.append(normal)
                albedo.append(0.0 if lamp else rho)
                emission.append(1.0 if lamp else 0.0)
    return tuple(np.array(a) for a in (corners, normals, albedo, emission))


def form_factors(points, normals, corners):
    """Share of a point's hemisphere (cosine-weighted) that each square fills, (points, squares), by Lambert's formula."""
    out = np.zeros((len(points), len(corners)))
    for k in range(4):
        a = corners[None, :, k] - points[:, None]
        b = corners[None, :, (k + 1) % 4] - points[:, None]
        cross = np.cross(a, b)
        size = np.linalg.norm(cross, axis=2)
        angle = np.arctan2(size, (a * b).sum(axis=2))
        out += angle * np.einsum("pqk,pk->pq", cross, normals) / np.where(size > 0, size, 1.0)
    return np.abs(out) / (2 * np.pi)


def seen_point(row, col):
    """Where the middle of a pixel meets the box, and the wall's normal and albedo."""
    eye = np.array(CAMERA["position_m"])
    forward = np.array(CAMERA["look_at_m"]) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 1, 0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    pitch = CAMERA["pixel_um"] * 1e-3 / CAMERA["focal_mm"]
    ray = forward + right * (col + 0.5 - CAMERA["cols"] / 2) * pitch - up * (row + 0.5 - CAMERA["rows"] / 2) * pitch
    best = (np.inf, None, None)
    for origin, u, v, rho in walls():
        normal = np.cross(u, v) / SIDE**2
        if ray @ normal < 0:
            t = ((origin - eye) @ normal) / (ray @ normal)
            best = min(best, (t, tuple(normal), rho), key=lambda b: b[0])
    return eye + best[0] * ray, np.array(best[1]), best[2]


def reference(bounces):
    """Radiance of the pixels of PIXELS for unit lamp radiance."""
    corners, normals, albedo, emission = squares()
    centers = corners.mean(axis=1)
    factors = form_factors(centers, normals, corners)
    np.fill_diagonal(factors, 0)
    same = np.abs(normals @ normals.T - 1) < 1e-9
    factors[same] = 0  # squares of one wall do not see each other
    radiance = emission.copy()
    for _ in range(bounces - 1):
        radiance = emission + albedo * (factors @ radiance)
    out = []
    for row, col in PIXELS:
        point, normal, rho = seen_point(row, col)
        f = form_factors(point[None], normal[None], corners)[0]
        f[np.abs(normals @ normal - 1) < 1e-9] = 0
        out.append(rho * f @ radiance)
    return np.array(out)


def test_the_reference_fills_the_hemisphere():
    corners, normals, _, _ = squares()
    point, normal, _ = seen_point(24, 24)
    f = form_factors(point[None], normal[None], corners)[0]
    f[np.abs(normals @ normal - 1) < 1e-9] = 0
    assert f.sum() == pytest.approx(1.0, abs=1e-9)


def scene(bounces):
    spectra = {name: Spectrum.flat(value) for name, value in ALBEDO.items()}
    return cornell_box(
        size_m=(SIDE, SIDE, SIDE),
        bounces=bounces,
        open_front=False,
        light_size_m=(LIGHT, LIGHT),
        light_drop_mm=0.02,
        black_scale=0.0,
        blocks=(),
        charts=(),
        spectra={**spectra, "lamp": Spectrum.flat(1.0)},
    )


@pytest.mark.parametrize("bounces", [1, 6, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)])
def test_twelve_points_of_a_closed_box(bounces):
    expected = reference(bounces)
    found, sigma = [], []
    for pixel in PIXELS:
        out = render(
            scene(bounces), camera=CAMERA, crop=(*pixel, 1, 1), wavelength_nm=BANDS, spp=20_000, seed=11, noise_target=1e-9
        )
        found.append(out.radiance.mean(dtype=float))
        sigma.append(out.settings["tiles"][0]["noise"])
    lit = expected > 0  # after one bounce the ceiling is dark
    assert np.all(np.array(found)[~lit] == 0)
    error = np.array(found)[lit] / expected[lit] - 1
    sigma = np.array(sigma)[lit]
    assert sigma.max() < 0.005
    np.testing.assert_array_less(np.abs(error), 0.01 + 2 * sigma)
    assert abs(error.mean()) < 0.004 + 3 * sigma.max() / np.sqrt(lit.sum())
