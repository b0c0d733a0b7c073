"""A raw capture: the only thing that the analyses accept, whoever made it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.errors import InputError
from isetval.core.provenance import Provenance
from isetval.core.sensor import Exposure, Position, Roi, RoiLike, Sensor, black_at, plane_names, plane_position

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Capture:
    """One raw frame, or a crop of one.

    Parameters
    ----------
    mosaic : uint16 array (rows, cols)
        Raw DN, black level included, no demosaic, no white balance.  Made read-only.
    sensor : Sensor
        The full sensor; its CFA and black level start at sensor pixel (0, 0).
    window : (row0, col0)
        Sensor pixel of ``mosaic[0, 0]``.
    exposure : Exposure
    provenance : mapping
        For people (file, hash, seeds, which black level was used).  No analysis reads it.
    """

    mosaic: NDArray[np.uint16]
    sensor: Sensor
    window: Position = (0, 0)
    exposure: Exposure = Exposure()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    codes: ClassVar[type] = np.uint16

    def __post_init__(self) -> None:
        mosaic = np.asarray(self.mosaic)
        if mosaic.ndim != 2 or mosaic.dtype != self.codes:
            raise InputError(
                f"mosaic is {mosaic.dtype} {mosaic.shape}; it needs {self.codes.__name__} (rows, cols); see Capture.from_array"
            )
        rows, cols = mosaic.shape
        row0, col0 = self.window
        if row0 < 0 or col0 < 0 or row0 + rows > self.sensor.rows or col0 + cols > self.sensor.cols:
            raise InputError(
                f"the window of {rows} x {cols} pixels at {self.window} leaves the sensor of "
                f"{self.sensor.rows} x {self.sensor.cols}; check window and sensor size"
            )
        mosaic = mosaic.view()
        mosaic.flags.writeable = False
        object.__setattr__(self, "mosaic", mosaic)
        object.__setattr__(self, "window", (int(row0), int(col0)))
        object.__setattr__(self, "provenance", Provenance.of(self.provenance))

    @classmethod
    def from_array(
        cls,
        mosaic: ArrayLike,
        *,
        cfa: str = "RGGB",
        black_dn: Any = 64,
        white_dn: float = 1023,
        pixel_um: float = 1.4,
        window: Position = (0, 0),
        time_s: float | None = None,
        iso: float | None = None,
        f_number: float | None = None,
        bits: int | None = None,
        sensor_shape: tuple[int, int] | None = None,
        provenance: Mapping[str, Any] | None = None,
    ) -> Capture:
        """A capture from a plain array (rows, cols) of DN.

        ``cfa`` and ``black_dn`` describe the *array's* first pixel (as a DNG's tags do);
        ``window`` says where that pixel lies on the sensor, whose size is ``sensor_shape`` or,
        by default, just holds the window.  Values must be whole numbers in 0..65535.

        Raises
        ------
        InputError
            For values that are not whole numbers in 0..65535, or an impossible geometry.
        """
        array = _as_uint16(np.asarray(mosaic))
        row0, col0 = window
        shape = sensor_shape or (row0 + array.shape[0], col0 + array.shape[1])
        # seen from sensor pixel (0, 0) the pattern is shifted by the window; the shift is its own inverse
        full = Sensor(1, 1, 1.0, cfa, black_dn, white_dn)
        pattern = cfa if cfa == "MONO" else "".join(cfa[((r + row0) % 2) * 2 + (c + col0) % 2] for r in (0, 1) for c in (0, 1))
        sensor = Sensor(
            rows=shape[0],
            cols=shape[1],
            pixel_um=pixel_um,
            cfa=pattern,
            black_dn=black_at(full.black_dn, (row0, col0)),
            white_dn=float(white_dn),
            bits=bits or max(8, min(16, int(np.ceil(np.log2(float(white_dn) + 1))))),
        )
        return cls(array, sensor, (row0, col0), Exposure(time_s, iso, f_number), provenance or {})


class ExpectedFrame(Capture):
    """A simulated frame whose codes (float32) are not rounded: what is measured in it follows a parameter without steps.

    Without noise (an expectation), or with a dither in place of rounding (`isetval.camera.exposing.dithered`).
    """

    codes: ClassVar[type] = np.float32


def _as_uint16(array: NDArray[Any]) -> NDArray[np.uint16]:
    if array.ndim != 2:
        raise InputError(f"the raw array has shape {array.shape}; it needs (rows, cols): one raw mosaic, not demosaiced")
    if array.dtype == np.uint16:
        return array
    if not np.issubdtype(array.dtype, np.number) or np.issubdtype(array.dtype, np.complexfloating):
        raise InputError(f"the raw array has type {array.dtype}; it needs whole numbers in 0..65535")
    if array.size and not np.all(np.isfinite(array)):
        raise InputError("the raw array holds values that are not finite; it needs whole numbers in 0..65535")
    low, high = (array.min(), array.max()) if array.size else (0, 0)
    if low < 0 or high > 65535:
        raise InputError(f"the raw array spans {low}..{high}; it needs whole numbers in 0..65535")
    out = array.astype(np.uint16)
    if not np.array_equal(out, array):
        raise InputError("the raw array holds fractions; it needs whole numbers (raw DN), so round or rescale it first")
    return out


def check_roi(capture: Capture, roi: RoiLike | None) -> Roi:
    """``roi`` as (row0, row1, col0, col1), half open, inside the capture; None is the whole frame."""
    rows, cols = capture.mosaic.shape
    if roi is None:
        return Roi(0, rows, 0, cols)
    found = Roi.of(roi)
    if not (0 <= found.row0 < found.row1 <= rows and 0 <= found.col0 < found.col1 <= cols):
        raise InputError(
            f"roi {tuple(found)} (row0, row1, col0, col1, half open) does not fit in the capture of {rows} x {cols} pixels"
        )
    return found


def planes_of(capture: Capture) -> tuple[str, ...]:
    """Names of the colour planes of a capture."""
    return plane_names(capture.sensor.cfa)


def plane_black_dn(capture: Capture, plane: str) -> float:
    """Black level in DN of a colour plane."""
    if capture.sensor.cfa == "MONO":
        return float(np.mean(capture.sensor.black_dn))
    row, col = plane_position(capture.sensor.cfa, plane)
    return capture.sensor.black_dn[row][col]


def plane_view(capture: Capture, plane: str, roi: RoiLike | None = None) -> tuple[NDArray[np.uint16], Position, int]:
    """A colour plane without a copy.

    Returns
    -------
    view : uint16 array (plane rows, plane cols)
        Raw DN, black included.
    first : (row, col)
        Mosaic pixel (of this capture) of ``view[0, 0]``.
    step : int
        Mosaic pixels between neighbours of the plane: 2, or 1 for MONO.
    """
    row0, row1, col0, col1 = check_roi(capture, roi)
    if capture.sensor.cfa == "MONO":
        return capture.mosaic[row0:row1, col0:col1], (row0, col0), 1
    origin = (capture.window[0] + row0, capture.window[1] + col0)
    row, col = plane_position(capture.sensor.cfa, plane, origin)
    return capture.mosaic[row0 + row : row1 : 2, col0 + col : col1 : 2], (row0 + row, col0 + col), 2


def black_image_dn(capture: Capture, roi: RoiLike | None = None) -> Float:
    """Black level of every mosaic pixel of ``roi``, float64 (rows, cols)."""
    row0, row1, col0, col1 = check_roi(capture, roi)
    corner = (capture.window[0] + row0, capture.window[1] + col0)
    tile = np.array(black_at(capture.sensor.black_dn, corner))
    if capture.sensor.cfa == "MONO":
        tile = np.full((2, 2), tile.mean())
    rows, cols = row1 - row0, col1 - col0
    return np.tile(tile, ((rows + 1) // 2, (cols + 1) // 2))[:rows, :cols]


def field_mm(sensor: Sensor, row: Any, col: Any) -> tuple[Any, Any]:
    """(x, y) in mm of the centre of sensor pixel (row, col), from the sensor's middle; y grows with the row."""
    pitch_mm = sensor.pixel_um * 1e-3
    return (col - (sensor.cols - 1) / 2) * pitch_mm, (row - (sensor.rows - 1) / 2) * pitch_mm
