"""Headerless raw files: samples only, so everything else has to be said by the person."""

from __future__ import annotations

import os
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from isetval.core.cache import bytes_hash
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.sensor import Exposure, Position, Sensor, black_at, pattern_at
from isetval.files.picture_file import Remark, check_not_constant, read_bytes, refusal
from isetval.files.picture_quality import clipping, clipping_remarks, code_remarks, code_use, line_remarks


def read_raw(
    path: str | os.PathLike[str],
    *,
    shape: tuple[int, int],
    cfa: str,
    bits: int,
    black_dn: Any = None,
    white_dn: float | None = None,
    byte_order: Literal["little", "big"] = "little",
    header_bytes: int = 0,
    pixel_um: float = 1.0,
    window: Position = (0, 0),
    exposure: Exposure | None = None,
) -> Capture:
    """Read whole numbers of 1 or 2 bytes, row after row, without a header that says what they are.

    Parameters
    ----------
    path : path
    shape : (rows, cols)
    cfa : str
        Pattern of the first pixel, or ``MONO``.
    bits : int
        Bits used, 1 to 16: up to 8 stored in one byte, above in two.
    black_dn : number or 2x2, optional
        In DN from the first pixel.  Unknown: 0, with a warning.
    white_dn : float, optional
        Default 2**bits - 1.
    byte_order : "little" or "big"
    header_bytes : int
        Bytes to skip.
    pixel_um : float
        Pixel pitch in um.
    window : (row0, col0)
        Sensor pixel of the first pixel, for a sensor that just holds the window.
    exposure : Exposure, optional

    Returns
    -------
    Capture
        ``provenance`` holds ``file``, ``sha256`` and ``warnings`` (code, message): clipped black,
        stuck or deviating rim lines, values that never occur.

    Raises
    ------
    InputError
        If the file is missing or its size does not fit, a value does not fit in ``bits``, or every
        pixel is the same.
    """
    data = read_bytes(path, kind="a raw file")
    mosaic = _samples(path, data, shape, bits=bits, byte_order=byte_order, header_bytes=header_bytes)
    first: Any = 0.0 if black_dn is None else black_dn
    at_first = Sensor(1, 1, pixel_um, cfa, first, 2.0**bits - 1 if white_dn is None else white_dn, bits)
    sensor = replace(
        at_first,
        rows=window[0] + shape[0],
        cols=window[1] + shape[1],
        cfa=pattern_at(cfa, window),
        black_dn=black_at(at_first.black_dn, window),
    )
    capture = Capture(mosaic, sensor, window, exposure or Exposure())
    provenance = {
        "file": Path(path).name,
        "sha256": bytes_hash(data),
        "black_used": "not known, taken as 0" if black_dn is None else "given",
        "warnings": tuple(asdict(r) for r in _remarks(capture, black_known=black_dn is not None)),
    }
    return replace(capture, provenance=provenance)


def _samples(
    path: object, data: bytes, shape: tuple[int, int], *, bits: int, byte_order: str, header_bytes: int
) -> NDArray[np.uint16]:
    """The mosaic, after everything that can contradict the file has been held against it."""
    rows, cols = shape
    if rows < 1 or cols < 1 or not 1 <= bits <= 16 or header_bytes < 0:
        said = f"shape {rows}x{cols}, {bits} bits, {header_bytes} header bytes"
        raise InputError(f"{path}: {said} were given; positive sizes and 1 to 16 bits are needed; correct them")
    size = 1 if bits <= 8 else 2
    wanted = header_bytes + rows * cols * size
    if len(data) != wanted:
        after = f" after {header_bytes} header bytes" if header_bytes else ""
        needed = f"{wanted} for {rows} x {cols} pixels of {size} bytes{after}"
        raise refusal(path, f"the file has {len(data)} bytes", needed, "correct the shape, the bits or the header size")
    kind = "u1" if size == 1 else ("<u2" if byte_order == "little" else ">u2")
    mosaic = np.frombuffer(data, kind, count=rows * cols, offset=header_bytes).astype(np.uint16).reshape(rows, cols)
    top = int(mosaic.max())
    if top >= 2**bits:
        needed = f"values up to {2**bits - 1} for {bits} bits"
        raise refusal(path, f"its highest value is {top}", needed, "correct the bits or the byte order")
    check_not_constant(path, mosaic, white=2.0**bits - 1)
    return mosaic


def _remarks(capture: Capture, *, black_known: bool) -> list[Remark]:
    remarks = (
        []
        if black_known
        else [Remark("black_not_known", "no black level was given: 0 is used, and every signal contains the true one")]
    )
    remarks += clipping_remarks(clipping(capture))
    remarks += line_remarks(capture.mosaic)
    return remarks + code_remarks(code_use(capture.mosaic))
