"""GainMap opcodes of a DNG: the shading correction that a phone proposes and this reader never applies.

DNG 1.4 specification, chapter 6 and 7: opcode lists are big-endian whatever the file's byte order.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError

GAIN_MAP = 9


@dataclass(frozen=True, eq=False)
class GainMap:
    """One GainMap opcode.

    ``area`` is (top, left, bottom, right) in pixels of the ActiveArea, ``pitch`` the (row, column)
    step inside it, ``spacing`` and ``origin`` the grid in relative coordinates 0..1, ``gains``
    float32 (map rows, map columns, map planes): factors without unit.
    """

    area: tuple[int, int, int, int]
    pitch: tuple[int, int]
    spacing: tuple[float, float]
    origin: tuple[float, float]
    gains: NDArray[np.float32]

    def summary(self) -> dict[str, Any]:
        """Plain numbers for people."""
        return {
            "first_pixel": [self.area[0], self.area[1]],
            "pitch": list(self.pitch),
            "grid": list(self.gains.shape),
            "gain_min": float(self.gains.min()),
            "gain_max": float(self.gains.max()),
        }


def gain_maps(opcodes: bytes) -> tuple[GainMap, ...]:
    """The GainMaps of an OpcodeList1, 2 or 3; other opcodes are passed over.

    Raises
    ------
    InputError
        If the list is shorter than it says.
    """
    try:
        (count,) = struct.unpack_from(">I", opcodes, 0)
        at, maps = 4, []
        for _ in range(count):
            code, _, _, size = struct.unpack_from(">IIII", opcodes, at)
            body = opcodes[at + 16 : at + 16 + size]
            if len(body) != size:
                raise InputError(f"an opcode list of {len(opcodes)} bytes ends inside opcode {code}")
            if code == GAIN_MAP:
                maps.append(_gain_map(body))
            at += 16 + size
    except struct.error:
        raise InputError(f"an opcode list of {len(opcodes)} bytes ends too early") from None
    return tuple(maps)


def _gain_map(body: bytes) -> GainMap:
    top, left, bottom, right, _, _, row_pitch, col_pitch, map_rows, map_cols = struct.unpack_from(">10I", body, 0)
    spacing_v, spacing_h, origin_v, origin_h = struct.unpack_from(">4d", body, 40)
    (planes,) = struct.unpack_from(">I", body, 72)
    number = map_rows * map_cols * planes
    if number == 0 or len(body) < 76 + 4 * number:
        raise InputError(f"a GainMap of {map_rows} x {map_cols} x {planes} gains has only {len(body) - 76} bytes of them")
    gains = np.frombuffer(body, dtype=">f4", count=number, offset=76).astype(np.float32)
    return GainMap(
        (top, left, bottom, right),
        (row_pitch, col_pitch),
        (spacing_v, spacing_h),
        (origin_v, origin_h),
        gains.reshape(map_rows, map_cols, planes),
    )
