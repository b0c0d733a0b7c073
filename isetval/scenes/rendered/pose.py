"""Where the camera stood before a scene: its pose by landmarks that a picture and the scene's file both hold.

Points (middles of patches) count with both coordinates, edges with their distance to the line that was found: collinearity
equations with priors, Gauss-Newton (Luhmann, Robson, Kyle, Boehm, Close-range photogrammetry, 2nd ed., sec. 4.2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import MeasurementError
from isetval.scenes.rendered.box import wall_camera
from isetval.scenes.rendered.placing import project_px

Float = NDArray[np.float64]
POSE_NAMES = ("x_m", "y_m", "z_m", "pan_deg", "tilt_deg", "roll_deg", "focal_mm")
POSE_SIGMA = {"x_m": 0.05, "y_m": 0.05, "z_m": 0.05, "pan_deg": 10.0, "tilt_deg": 10.0, "roll_deg": 10.0}
"""About the scene file's camera: a tripod placed by eye.  They decide where landmarks do not."""
FOCAL_SHARE = 0.01  # Exif states .01 mm of 4.38; the image plane of a focused lens lies up to 1 % behind it
LEAST_NUMBERS = 6  # as many as a pose has


@dataclass(frozen=True, eq=False)
class Landmarks:
    """What was found of a scene: ``points_m`` (n, 3) at ``places_px`` (n, 2; row, col), and the ends of edges (k, 2, 3) on lines.

    A line is a point (row, col) and its unit normal, (k, 4).  Sigmas are those of one coordinate and of one line, in px.
    """

    points_m: Float = field(default_factory=lambda: np.empty((0, 3)))
    places_px: Float = field(default_factory=lambda: np.empty((0, 2)))
    sigma_px: float = 1.0
    ends_m: Float = field(default_factory=lambda: np.empty((0, 2, 3)))
    lines_px: Float = field(default_factory=lambda: np.empty((0, 4)))
    line_sigma_px: float = 1.0

    @property
    def numbers(self) -> int:
        """Numbers that were measured."""
        return 2 * len(self.points_m) + 2 * len(self.ends_m)

    def gaps_px(self, camera: Mapping[str, Any]) -> Float:
        """Where the camera sees the landmarks less where they were found: coordinates of points, then distances of ends."""
        points = project_px(camera, self.points_m) - self.places_px
        ends = project_px(camera, self.ends_m) - self.lines_px[:, None, :2]
        return np.concatenate([points.ravel(), np.einsum("ked,kd->ke", ends, self.lines_px[:, 2:]).ravel()])

    @property
    def sigmas_px(self) -> Float:
        """One for each gap."""
        return np.repeat([self.sigma_px, self.line_sigma_px], [2 * len(self.points_m), 2 * len(self.ends_m)])


@dataclass(frozen=True, eq=False)
class ScenePose:
    """A camera's pose (`POSE_NAMES`) with its covariance (7, 7).

    ``error_px`` is the rms gap that is left, ``chi2`` on ``dof`` whether the stated sigmas explain it; where they do not, the
    covariance is that much wider.  ``picture_sigma_px`` (row, col) is what the pose's uncertainty moves the landmarks.
    """

    values: Mapping[str, float]
    covariance: Float
    error_px: float
    chi2: float
    dof: int
    picture_sigma_px: tuple[float, float]
    camera: Mapping[str, Any]

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviations by name."""
        return dict(zip(POSE_NAMES, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


def fit_pose(
    found: Landmarks,
    start: Mapping[str, float],
    *,
    lens: Mapping[str, Any],
    turned_deg: float = 0.0,
    focal_sigma_mm: float | None = None,
) -> ScenePose:
    """Most probable pose for the landmarks, about a stated one.

    Parameters
    ----------
    found : Landmarks
    start : mapping
        Stated pose and ``focal_mm``; what is missing is 0.  Priors about it: `POSE_SIGMA`, ``focal_sigma_mm`` (default 1 %).
    lens : mapping
        ``pixel_um``, ``rows``, ``cols`` of the sensor.
    turned_deg : float
        The shot's own rotation, to which ``roll_deg`` adds.

    Raises
    ------
    MeasurementError
        For fewer than six measured numbers, or a fit that does not end before the camera passes a landmark.
    """
    from scipy.optimize import least_squares

    if found.numbers < LEAST_NUMBERS:
        raise MeasurementError(f"landmarks gave {found.numbers} numbers; a pose needs {LEAST_NUMBERS} (3 points or edges)")
    stated = np.array([float(start.get(name, 0.0)) for name in POSE_NAMES])
    own = FOCAL_SHARE * stated[-1] if focal_sigma_mm is None else focal_sigma_mm
    scale = np.array([*POSE_SIGMA.values(), own])

    def camera(step: Float) -> dict[str, Any]:
        named = dict(zip(POSE_NAMES, (stated + scale * step).tolist(), strict=True))
        return wall_camera(**(named | {"roll_deg": named["roll_deg"] + turned_deg}), **lens)

    def gaps(step: Float) -> Float:
        return np.concatenate([found.gaps_px(camera(step)) / found.sigmas_px, step])

    fitted = least_squares(gaps, np.zeros(len(POSE_NAMES)), method="lm", x_scale=1.0, max_nfev=2000)
    left = found.gaps_px(camera(fitted.x))
    if not (fitted.success and np.isfinite(left).all()):
        raise MeasurementError("the landmarks fit no pose near the stated camera; check its place in the scene file")
    chi2, dof = float(np.sum((left / found.sigmas_px) ** 2)), max(found.numbers - LEAST_NUMBERS, 1)
    jacobian = np.asarray(fitted.jac)
    step_covariance = np.linalg.inv(jacobian.T @ jacobian) * max(1.0, chi2 / dof)
    slopes = jacobian[: 2 * len(found.points_m)] * found.sigma_px
    moved = np.sqrt(np.einsum("ij,jk,ik->i", slopes, step_covariance, slopes)).reshape(-1, 2)
    picture = moved.mean(axis=0) if len(moved) else np.full(2, found.line_sigma_px)
    return ScenePose(
        dict(zip(POSE_NAMES, (stated + scale * fitted.x).tolist(), strict=True)),
        step_covariance * np.outer(scale, scale),
        float(np.sqrt(np.mean(left**2))),
        chi2,
        dof,
        (float(picture[0]), float(picture[1])),
        camera(fitted.x),
    )
