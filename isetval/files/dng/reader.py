"""DNG reader: samples as stored, every level and all metadata from the tags, refusals by name."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.cache import bytes_hash
from isetval.core.capture import Capture
from isetval.core.provenance import Provenance
from isetval.core.sensor import Exposure, Position, Sensor, black_at, pattern_at
from isetval.files.dng.levels import Levels, active_area, read_levels
from isetval.files.dng.metadata import read_exposure, read_identity, read_pixel_pitch
from isetval.files.dng.optical_black import BlackChoice, OpticalBlack, choose_black, optical_black
from isetval.files.dng.samples import check_layout, decode
from isetval.files.dng.sensor_window import read_window
from isetval.files.dng.tags import LINEAR_RAW, RawTags, cfa_letters, open_tags
from isetval.files.picture_file import Buffer, Remark, check_not_constant, read_buffer
from isetval.files.picture_quality import clipping, clipping_remarks, describe_capture, line_remarks


@dataclass(frozen=True, eq=False)
class _Decoded:
    """What one pass over a file yields, before a black level is chosen."""

    mosaic: NDArray[np.uint16]
    cfa: str
    bits: int
    pixel_um: float
    levels: Levels
    margin: OpticalBlack | None
    window: Position
    sensor_shape: tuple[int, int]
    exposure: Exposure
    metadata: dict[str, Any]
    remarks: list[Remark]


def read_dng(path: str | os.PathLike[str], *, black: BlackChoice = "auto") -> Capture:
    """Read a DNG into a capture at its place on the sensor.

    Samples are as stored: not clipped, not white balanced, no shading correction applied.  All levels
    come from the tags.  Where the hidden margin of the frame holds plausible optical black that
    differs from the BlackLevel tag by more than three standard errors, the optical black is used
    (one value for each place of the 2x2 pattern) and ``provenance`` says so.  It is estimated for every
    file on its own; ``place_on_sensor`` puts the one black level of a campaign in its place.

    A crop that states its place (as `write_dng` does) gets its window and the size of its sensor.  One
    that does not, and a whole picture, start at (0, 0) of a sensor of their own size.

    Parameters
    ----------
    path : path
        Read whole, and once: ``sha256`` is of the bytes that were decoded.
    black : "auto", "tag" or "optical"
        Which black level to use; "optical" refuses a file without a plausible margin.

    Returns
    -------
    Capture
        ``provenance`` (JSON-able) holds ``file``, ``sha256``, ``black_used``, ``black_tag_dn``,
        ``black_dn``, ``optical_black``, ``window_stated``, ``warnings`` (code, message), ``make``, ``model``,
        ``software``, ``description``, ``date_time``, ``color_matrix``, ``as_shot_neutral``,
        ``noise_profile``, ``gain_maps``, ``focal_length_mm``, ``active_area``; None where absent.

    Raises
    ------
    InputError
        For a file that is not a whole Bayer or one-channel DNG with black and white level, or that exceeds
        the budgets for hostile files: the message says what was found, what is needed and what to do.
    """
    data = read_buffer(path)
    decoded = _decode(path, data)
    levels = decoded.levels
    black_dn, used, remark = choose_black(path, levels, decoded.margin, black)
    sensor = Sensor(
        *decoded.sensor_shape,
        decoded.pixel_um,
        pattern_at(decoded.cfa, decoded.window),
        black_at(black_dn, decoded.window),
        float(levels.white),
        decoded.bits,
    )
    capture = Capture(decoded.mosaic, sensor, decoded.window, decoded.exposure)
    remarks = [*remark, *decoded.remarks, *clipping_remarks(clipping(capture)), *line_remarks(decoded.mosaic)]
    provenance = {
        "file": Path(path).name,
        "black_used": used,
        "black_dn": [list(row) for row in black_dn],
        "black_tag_dn": [list(row) for row in levels.black_dn],
        "optical_black": None if decoded.margin is None else asdict(decoded.margin),
        "warnings": tuple(asdict(r) for r in remarks),
        **decoded.metadata,
    }
    return Capture(decoded.mosaic, sensor, decoded.window, decoded.exposure, _with_hash(provenance, decoded.mosaic, data))


def _with_hash(facts: dict[str, Any], mosaic: NDArray[np.uint16], data: Buffer) -> Provenance:
    """Facts and the hash of the bytes: when it is asked for, where the mosaic holds them anyway, else at once."""
    held = np.may_share_memory(mosaic, np.frombuffer(data, np.uint8))
    return Provenance(facts, {"sha256": lambda: bytes_hash(data)}) if held else Provenance(facts | {"sha256": bytes_hash(data)})


def describe_file(path: str | os.PathLike[str], *, black: BlackChoice = "auto") -> dict[str, Any]:
    """What a DNG holds and what is doubtful about it, ready for JSON; see ``describe_capture``.

    Raises
    ------
    InputError
        As :func:`read_dng`.
    """
    return describe_capture(read_dng(path, black=black))


def _decode(path: object, data: Buffer) -> _Decoded:
    with open_tags(path, data) as tags:
        layout = check_layout(path, tags, data)
        area, remarks = active_area(path, tags, rows=layout.rows, cols=layout.cols)
        top, left, bottom, right = area
        shape = (bottom - top, right - left)
        levels = read_levels(path, tags, shape=shape)
        frame = decode(path, data, tags, layout)
        mosaic = np.ascontiguousarray(frame[top:bottom, left:right])
        check_not_constant(path, mosaic, white=float(levels.white))
        margin = optical_black(frame, area, black_dn=levels.black_dn, white_dn=float(levels.white))
        stated = read_window(tags, first=(top, left), shape=shape, stored=(layout.rows, layout.cols))
        window, sensor_shape, window_remarks = stated or ((0, 0), shape, ())
        exposure, exposure_remarks = read_exposure(tags)
        pitch_um, pitch_remarks = read_pixel_pitch(tags)
        metadata, more = read_identity(tags)
        return _Decoded(
            mosaic,
            _cfa(tags),
            min(layout.bits, max(1, (int(levels.white)).bit_length())),
            pitch_um,
            levels,
            margin,
            window,
            sensor_shape,
            exposure,
            {**metadata, "active_area": list(area), "window_stated": stated is not None and not window_remarks},
            [*remarks, *levels.remarks, *more, *exposure_remarks, *pitch_remarks, *window_remarks],
        )


def _cfa(tags: RawTags) -> str:
    return "MONO" if int(tags.value(262)) == LINEAR_RAW else cfa_letters(bytes(tags.value(33422)))
