"""The pose of a camera by landmarks: true poses come back within their stated errors."""

from __future__ import annotations

import numpy as np
import pytest

from isetval.core.errors import MeasurementError
from isetval.scenes.rendered.box import PAPER_EDGES, Chart, cornell_box, wall_camera
from isetval.scenes.rendered.placing import project_px
from isetval.scenes.rendered.pose import POSE_NAMES, Landmarks, fit_pose

LENS = {"pixel_um": 1.4, "rows": 3024, "cols": 4032}
STATED = {"z_m": 0.40, "focal_mm": 4.38}
SPREAD = (0.010, 0.010, 0.010, 2.0, 2.0, 2.0, 0.02)
POINT_PX, LINE_PX, N = 0.1, 0.05, 200


def _scene():
    targets = cornell_box(charts=(Chart((0.035, 0.055)),), edges=PAPER_EDGES)["targets"]
    return np.array([np.mean(c, axis=0) for c in targets["charts"][0].values()]), np.array(targets["edges"])


def _seen(camera, rng):
    middles, ends = _scene()
    lines = []
    for edge in project_px(camera, ends):
        along = (edge[1] - edge[0]) / np.linalg.norm(edge[1] - edge[0])
        normal = np.array([-along[1], along[0]])
        found = edge + normal * rng.normal(0, LINE_PX, (2, 1))
        along = (found[1] - found[0]) / np.linalg.norm(found[1] - found[0])
        lines.append([*found[0], -along[1], along[0]])
    places = project_px(camera, middles) + rng.normal(0, POINT_PX, (len(middles), 2))
    return Landmarks(middles, places, POINT_PX, ends, np.array(lines), LINE_PX)


def test_pulls_of_the_pose():
    """200 cameras placed at random before the box: six of seven numbers are found by the landmarks alone."""
    rng = np.random.default_rng(3)
    pulls, chi2 = [], []
    for _ in range(N):
        truth = dict(zip(POSE_NAMES, rng.normal(0, SPREAD) + [0, 0, 0.4, 0, 0, 0, 4.38], strict=True))
        found = fit_pose(_seen(wall_camera(**truth, **LENS), rng), STATED, lens=LENS, focal_sigma_mm=0.02)
        pulls.append([(found.values[name] - truth[name]) / found.sigma[name] for name in POSE_NAMES])
        chi2.append(found.chi2 / found.dof)
    assert np.mean(chi2) == pytest.approx(1, abs=0.1)
    rms = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert (np.abs(rms - 1) < 4 * np.sqrt(1 / (2 * N))).all(), dict(zip(POSE_NAMES, rms, strict=True))


def test_a_shot_that_is_turned_keeps_its_roll():
    rng = np.random.default_rng(0)
    camera = wall_camera(0.39, x_m=0.01, roll_deg=90.0 + 1.5, **LENS)
    found = fit_pose(_seen(camera, rng), STATED, lens=LENS, turned_deg=90.0)
    assert found.values["roll_deg"] == pytest.approx(1.5, abs=4 * found.sigma["roll_deg"])


def test_too_few_landmarks_are_refused():
    middles, _ = _scene()
    camera = wall_camera(0.4, **LENS)
    two = Landmarks(middles[:2], project_px(camera, middles[:2]), 0.1)
    with pytest.raises(MeasurementError, match="landmarks gave 4 numbers; a pose needs 6"):
        fit_pose(two, STATED, lens=LENS)


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 90.0])
def test_turning_a_camera_turns_its_picture(angle_deg):
    """The picture of a camera that rolls clockwise turns the other way about the middle of the frame."""
    point = [0.02, 0.03, -0.1]
    middle = np.array([(LENS["rows"] - 1) / 2, (LENS["cols"] - 1) / 2])
    upright = project_px(wall_camera(0.4, pan_deg=2.0, tilt_deg=1.0, **LENS), point) - middle
    turned = project_px(wall_camera(0.4, pan_deg=2.0, tilt_deg=1.0, roll_deg=angle_deg, **LENS), point) - middle
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    np.testing.assert_allclose(turned, [c * upright[0] - s * upright[1], s * upright[0] + c * upright[1]], atol=1e-9)
