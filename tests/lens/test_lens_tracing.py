"""Tracing against a second implementation of the file's meaning, written ray by ray with angles."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from isetval.core.errors import InputError
from isetval.lens.ray_transfer import RayTransferLens
from isetval.lens.transfer_file import load_lens


def trace_one(source: dict, film_mm: float, x: float, y: float, dx: float, dy: float) -> tuple[list[float], bool]:
    """One ray by the words of the format description, nothing shared with the package."""
    dz = math.sqrt(1 - dx * dx - dy * dy)
    step = (film_mm - source["planeoffsetinput"]) / dz
    qx, qy = x + dx * step, y + dy * step
    r = math.hypot(qx, qy)
    g = math.pi / 2 - math.atan2(qy, qx)
    u, v = dx * math.cos(g) - dy * math.sin(g), dx * math.sin(g) + dy * math.cos(g)
    table = source["polynomials"][0]
    p = table["passnopass"]
    cx, cy, rx, ry = (np.interp(r, p["positions"], p[k]) for k in ("centersX", "centersY", "radiiX", "radiiY"))
    h = p["intersectPlaneDistance"]
    px, py = h * u / dz, r + h * v / dz
    out = {}
    for poly in table["poly"]:
        lists = [np.atleast_1d(poly[k]) for k in ("coeff", "termr", "termdx", "termdy")]
        terms = zip(*lists, strict=True)
        out[poly["outputname"]] = sum(c * r**i * u**j * v**k for c, i, j, k in terms)
    back = [
        (math.cos(g) * a + math.sin(g) * b, -math.sin(g) * a + math.cos(g) * b)
        for a, b in ((out["outx"], out["outy"]), (out["outdx"], out["outdy"]))
    ]
    ez = math.sqrt(1 - back[1][0] ** 2 - back[1][1] ** 2)
    return [*back[0], out["outz"], *back[1], ez], ((px - cx) / rx) ** 2 + ((py - cy) / ry) ** 2 <= 1


@pytest.mark.parametrize("degree", [4, 5, 7])
def test_tracing_agrees_with_a_ray_by_ray_reading_of_the_file(pixel4a_folder: Path, degree: int) -> None:
    file = pixel4a_folder / f"rtf_pixel4a_rear_ellipse_poly{degree}.json"
    source = json.loads(file.read_text())
    rng = np.random.default_rng(11)
    points = rng.uniform(-2.4, 2.4, (2, 300))
    slope = (rng.uniform(-0.45, 0.45, (2, 300)) - points) / 2.6
    direction = slope / np.sqrt(1 + (slope**2).sum(axis=0))
    rays = load_lens(file).trace(points, direction, film_mm=0.51, block=64)
    wanted = [trace_one(source, 0.51, *p, *d) for p, d in zip(points.T, direction.T, strict=True)]
    found = np.vstack([rays.origin_mm, rays.direction])
    # 1e-9: round-off of sums of terms up to 1e2 in another order; outz of degree 4 carries 1e-11 residues
    np.testing.assert_allclose(found, np.array([w[0] for w in wanted]).T, atol=1e-9)
    assert rays.passed.tolist() == [w[1] for w in wanted]
    assert 0.2 < rays.passed.mean() < 0.9


def test_the_block_size_does_not_change_the_rays(pixel4a: RayTransferLens) -> None:
    rng = np.random.default_rng(5)
    points, direction = rng.uniform(-2, 2, (2, 1000)), rng.uniform(-0.3, 0.3, (2, 1000))
    whole = pixel4a.trace(points, direction, film_mm=0.49)
    for block in (1, 7, 999):
        parts = pixel4a.trace(points, direction, film_mm=0.49, block=block)
        np.testing.assert_allclose(parts.origin_mm, whole.origin_mm, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(parts.passed, whole.passed)


def test_rotating_film_point_and_ray_rotates_the_result(pixel4a: RayTransferLens) -> None:
    point, direction = np.array([[0.3], [1.1]]), np.array([[-0.05], [-0.35]])
    a = 0.7
    turn = np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])
    straight = pixel4a.trace(point, direction, film_mm=0.5)
    turned = pixel4a.trace(turn @ point, turn @ direction, film_mm=0.5)
    np.testing.assert_allclose(turned.origin_mm[:2], turn @ straight.origin_mm[:2], atol=1e-12)
    np.testing.assert_allclose(turned.direction[:2], turn @ straight.direction[:2], atol=1e-12)


def test_beyond_the_table_rays_are_marked_and_not_black(pixel4a: RayTransferLens) -> None:
    corner = 7.056 / 2
    point = np.array([[0.0, 0.0], [corner, 3.4]])
    middle = pixel4a.table().region.centers_mm[-1, 1]
    slope = (np.array([[0.0, 0.0], [middle, middle]]) - point) / 2.5893
    rays = pixel4a.trace(point, slope / np.sqrt(1 + (slope**2).sum(axis=0)))
    assert rays.beyond_table.tolist() == [True, False]
    assert rays.passed.tolist() == [True, True]
    factor = pixel4a.irradiance_factor(np.array([corner, 3.5]), np.array([0.0, 0.0]))
    # the fall-off continues: cos^4 of the chief ray changes by about 1 % over the last 0.028 mm
    assert 0.97 < factor[0] / factor[1] < 1.0


def test_points_and_directions_of_different_number_are_refused(pixel4a: RayTransferLens) -> None:
    with pytest.raises(InputError, match="points"):
        pixel4a.trace(np.zeros((2, 3)), np.zeros((2, 4)))
