"""Fits from rays: known lenses come back, the degree follows the hold-out error, regions hold the rays."""

from __future__ import annotations

import numpy as np
import pytest

from isetval.core.errors import InputError
from isetval.lens.fit import RayTable, convex_rim, from_rays, minimum_ellipse
from isetval.lens.illumination import pupil_rays
from isetval.lens.prescription import Prescription, Surface
from isetval.lens.prescription_rays import Planes, ray_transfer, sample_rays
from isetval.lens.ray_transfer import RayTransferLens
from isetval.lens.tracing import combine


def rays_of(lens: RayTransferLens, heights: np.ndarray, *, turn: bool = False) -> RayTable:
    """The lens's own rays from its input plane; ``turn`` puts every beam at another azimuth."""
    points, directions = [], []
    for i, r in enumerate(heights):
        a = 0.7 * i if turn else np.pi / 2
        point = r * np.array([np.cos(a), np.sin(a)])
        beam = pupil_rays(lens, point, rings=4, azimuths=24)
        directions += [beam.direction[:2], beam.rim_direction[:2]]
        points.append(np.tile(point[:, None], (1, beam.direction.shape[1] + beam.rim_direction.shape[1])))
    point, direction = np.hstack(points), np.hstack(directions)
    out = lens.trace(point, direction)
    return RayTable(point, direction, out.origin_mm, out.direction)


def refit(lens: RayTransferLens, rays: RayTable, **options):
    return from_rays(
        rays,
        name=lens.name,
        thickness_mm=lens.thickness_mm,
        plane_offset_input_mm=lens.plane_offset_input_mm,
        plane_offset_output_mm=lens.plane_offset_output_mm,
        plane_distance_mm=lens.table().region.plane_distance_mm,
        **options,
    )


@pytest.fixture(scope="module")
def known(pixel4a: RayTransferLens) -> tuple[RayTransferLens, RayTable]:
    return pixel4a, rays_of(pixel4a, np.arange(1, 51) * 0.07)


def test_a_polynomial_lens_comes_back_from_its_own_rays(known) -> None:
    lens, rays = known
    found = refit(lens, rays, symmetry="none", degrees=(2, 3, 4, 5, 6))
    assert found.degree == 4
    assert found.holdout[4][0] < 1e-6  # um; the rays are exact polynomials of degree 4
    for name in ("outx", "outy", "outdx", "outdy"):
        here, there = found.lens.table().polynomials.outputs[name], lens.table().polynomials.outputs[name]
        assert np.array_equal(here.exponents, there.exponents)
        np.testing.assert_allclose(here.coefficients, there.coefficients, atol=2e-7)


def test_the_pass_region_comes_back_too(known) -> None:
    lens, rays = known
    found = refit(lens, rays, symmetry="mirror", degrees=(4,))
    old, new = lens.table().region, found.lens.table().region
    # mirror symmetry moves the center to x = 0: an ellipse around both halves is wider by at most the offset
    slack = np.abs(old.centers_mm[1:, :1]) + 5e-4
    assert (np.abs(new.radii_mm - old.radii_mm[1:]) <= slack).all()
    np.testing.assert_allclose(new.centers_mm[:, 1], old.centers_mm[1:, 1], atol=2e-3)
    r = np.array([0.5, 1.5, 3.0])
    wider = float(np.abs(old.centers_mm[:, 0] / old.radii_mm[:, 0]).max())
    np.testing.assert_allclose(found.lens.irradiance_factor(r, 0 * r), lens.irradiance_factor(r, 0 * r), rtol=wider + 2e-3)


def test_rays_at_any_azimuth_give_the_same_fit(known) -> None:
    lens, rays = known
    straight = refit(lens, rays, symmetry="none", degrees=(4,))
    turned = refit(lens, rays_of(lens, np.arange(1, 51) * 0.07, turn=True), symmetry="none", degrees=(4,))
    points, direction = np.array([[0.4], [1.5]]), np.array([[-0.05], [-0.4]])
    a, b = (f.lens.trace(points, direction) for f in (straight, turned))
    np.testing.assert_allclose(a.origin_mm, b.origin_mm, atol=1e-6)


def test_noise_in_the_rays_stops_the_degree_from_growing(known) -> None:
    lens, rays = known
    rng = np.random.default_rng(4)
    noisy = RayTable(
        rays.point_mm,
        rays.direction,
        rays.out_point_mm + np.array([[1.0], [1.0], [0.0]]) * rng.normal(0, 0.02, rays.out_point_mm.shape),
        rays.out_direction + rng.normal(0, 2e-3, rays.out_direction.shape),
    )
    found = refit(lens, noisy, symmetry="none", degrees=(3, 4, 5, 6, 7, 8))
    assert found.degree <= 4
    # hold-out error per coordinate is the noise: 20 um sqrt(2) for x and y together, sampled by the held-out rays
    sd = 20 * np.sqrt(2) / np.sqrt(2 * 2 * found.rays_held_out)
    assert found.holdout[4][0] == pytest.approx(20 * np.sqrt(2), abs=4 * sd + 0.01 * 20)


def stopped_lens() -> Prescription:
    """A symmetric pair of menisci about a stop (periscopic form), 10 mm focal length class, F/8."""
    return Prescription(
        "periscope",
        (
            Surface(2.2, 0.5, index_d=1.523, abbe=58.6, semi_aperture_mm=1.2),
            Surface(2.35, 0.6, semi_aperture_mm=1.1),
            Surface(thickness_mm=0.6, semi_aperture_mm=0.5, stop=True),
            Surface(-2.35, 0.5, index_d=1.523, abbe=58.6, semi_aperture_mm=1.1),
            Surface(-2.2, 0.0, semi_aperture_mm=1.2),
        ),
    )


def test_rays_of_a_prescription_are_fitted_to_their_holdout_error() -> None:
    lens = stopped_lens()
    fitted, fits = ray_transfer(lens, sensor_radius_mm=2.5, positions=21, degrees=(3, 5, 7), wavelengths_nm=(550.0, 630.0))
    fit = fits[550.0]
    errors = [fit.holdout[d] for d in (3, 5, 7)]
    assert errors[0] > errors[1] > errors[2]
    # fresh rays at heights and pupil points that no fit has seen
    planes = Planes(fitted.plane_offset_input_mm, 1.0, fitted.table().region.plane_distance_mm)
    fresh, _ = sample_rays(lens, [0.33, 1.21, 2.17], planes, rings=3, azimuths=20)
    fresh = fresh.usable()
    out = fitted.trace(fresh.point_mm, fresh.direction)
    error_mrad = np.sqrt(((out.direction[:2] - fresh.out_direction[:2]) ** 2).sum(axis=0).mean()) * 1e3
    assert error_mrad < 2 * fit.holdout[fit.degree][1]
    assert fit.holdout[fit.degree][1] < 0.05  # mrad: .5 um at 10 mm
    assert fitted.wavelengths_nm == (550.0, 630.0)


def test_irradiance_of_the_fit_is_that_of_the_prescription() -> None:
    lens = stopped_lens()
    fitted, _ = ray_transfer(lens, sensor_radius_mm=2.5, positions=26, degrees=(5,), region="rim")
    h, a = fitted.table().region.plane_distance_mm, fitted.plane_offset_input_mm
    rng = np.random.default_rng(9)
    for r in (0.0, 1.0, 2.3):
        n = 60_000
        middle = fitted.table().region.center(np.array([r]))[1, 0]
        target = np.stack([rng.uniform(-1.2, 1.2, n), middle + rng.uniform(-1.2, 1.2, n)])
        slope = (target - np.array([[0.0], [r]])) / h
        dz = 1 / np.sqrt(1 + (slope**2).sum(axis=0))
        start = np.stack([np.zeros(n), np.full(n, r), np.full(n, -a)])
        passed = lens.from_film(start, np.stack([*(slope * dz), dz])).passed
        sample = passed * dz**4 / h**2 * 2.4**2
        error = sample.std() / np.sqrt(n)
        # 4 sigma of the random rays, and 5e-4 for the polygon of 120 sides
        assert abs(sample.mean() - float(fitted.irradiance_factor(0.0, r))) < 4 * error + 5e-4 * sample.mean()


def test_wrong_parity_terms_are_absent_from_a_rotational_fit() -> None:
    fitted, _ = ray_transfer(stopped_lens(), sensor_radius_mm=2.0, positions=11, degrees=(5,))
    outputs = fitted.table().polynomials.outputs
    assert (outputs["outx"].exponents[:, 1] % 2 == 1).all()
    assert (outputs["outy"].exponents[:, 1] % 2 == 0).all()
    assert (outputs["outy"].exponents.sum(axis=1) % 2 == 1).all()


def test_minimum_ellipse_of_points_on_an_ellipse() -> None:
    angle = np.arange(40) * np.pi / 20
    points = np.array([[0.0], [1.5]]) + np.stack([0.7 * np.cos(angle), 0.3 * np.sin(angle)])
    inside = np.array([[0.0], [1.5]]) + 0.5 * np.stack([0.7 * np.cos(angle), 0.3 * np.sin(angle)])
    center, semi = minimum_ellipse(np.hstack([points, inside]))
    np.testing.assert_allclose(center, [0.0, 1.5], atol=1e-6)
    np.testing.assert_allclose(semi, [0.7, 0.3], rtol=1e-5)


def test_minimum_ellipse_of_a_square_is_its_circumcircle() -> None:
    _, semi = minimum_ellipse(np.array([[1.0, -1.0, 1.0, -1.0, 0.2], [1.0, 1.0, -1.0, -1.0, 0.1]]))
    np.testing.assert_allclose(semi, np.sqrt(2.0), rtol=1e-5)


def test_convex_rim_of_a_square() -> None:
    _, rim = convex_rim(np.array([[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0]]), azimuths=8)
    np.testing.assert_allclose(rim, np.where(np.arange(8) % 2, np.sqrt(2), 1.0), rtol=1e-12)


def test_too_few_rays_and_unknown_words_are_refused(known) -> None:
    lens, rays = known
    few = RayTable(rays.point_mm[:, :40], rays.direction[:, :40], rays.out_point_mm[:, :40], rays.out_direction[:, :40])
    with pytest.raises(InputError, match="usable rays"):
        refit(lens, few)
    with pytest.raises(InputError, match="spherical"):
        refit(lens, rays, symmetry="spherical")
    with pytest.raises(InputError, match="square"):
        refit(lens, rays, degrees=(3,), region="square")
    with pytest.raises(InputError, match="shapes"):
        RayTable(rays.point_mm, rays.direction[:, :3], rays.out_point_mm, rays.out_direction)


def test_lenses_with_other_planes_cannot_be_combined(pixel4a: RayTransferLens) -> None:
    other, _ = ray_transfer(stopped_lens(), sensor_radius_mm=2.0, positions=5, degrees=(3,))
    with pytest.raises(InputError, match="planes"):
        combine([pixel4a, other])
