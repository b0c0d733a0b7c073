"""Put a decoded crop back on the sensor it was cut from."""

from __future__ import annotations

import numpy as np

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.sensor import Position, Sensor, black_at, pattern_at

BLACK_TOLERANCE_DN = 0.5


def place_on_sensor(
    capture: Capture,
    sensor: Sensor,
    window: Position = (0, 0),
    *,
    black_tolerance_dn: float = BLACK_TOLERANCE_DN,
) -> Capture:
    """The same pixels as a window of ``sensor``: what a campaign file knows and a cropped DNG does not.

    Parameters
    ----------
    capture : Capture
        As read from its file.
    sensor : Sensor
        Full sensor of the campaign; its geometry and levels hold from here on.
    window : (row0, col0)
        Sensor pixel of the capture's first pixel.
    black_tolerance_dn : float
        Largest difference in DN between the black level of the file and of the sensor at any place of
        the 2x2 pattern.

    Returns
    -------
    Capture

    Raises
    ------
    InputError
        If colour pattern, black level, white level or size of the file contradict sensor and window.
    """
    name = capture.provenance.get("file", "capture")
    own, wanted = pattern_at(capture.sensor.cfa, capture.window), pattern_at(sensor.cfa, window)
    if own != wanted:
        raise InputError(
            f"{name}: its colour pattern starts {own}, the camera's {sensor.cfa} at window {tuple(window)} needs {wanted}; "
            "correct the window or the camera's cfa"
        )
    rows, cols = capture.mosaic.shape
    if window[0] < 0 or window[1] < 0 or window[0] + rows > sensor.rows or window[1] + cols > sensor.cols:
        raise InputError(
            f"{name}: its {rows} x {cols} pixels at window {tuple(window)} leave the camera's sensor of "
            f"{sensor.rows} x {sensor.cols}; correct the window or the camera's rows and cols"
        )
    if sensor.white_dn != capture.sensor.white_dn:
        raise InputError(
            f"{name}: its white level is {capture.sensor.white_dn:g} DN, the camera's {sensor.white_dn:g}; "
            "correct white_dn of the camera, or leave the file out"
        )
    blacks = [np.array(black_at(s.black_dn, at)) for s, at in ((capture.sensor, capture.window), (sensor, window))]
    apart_dn = float(np.abs(blacks[0] - blacks[1]).max())
    if not apart_dn <= black_tolerance_dn:
        used = capture.provenance.get("black_used", "its own")
        raise InputError(
            f"{name}: its black level ({used}) is {np.round(blacks[0], 3).tolist()} DN, the camera's {blacks[1].tolist()}, "
            f"{apart_dn:.2f} DN apart and {black_tolerance_dn:g} allowed; correct black_dn of the camera"
        )
    return Capture(capture.mosaic, sensor, window, capture.exposure, capture.provenance)
