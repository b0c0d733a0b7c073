"""DNG reader: samples as stored, every level and all metadata from the tags, refusals by name."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.hashing import bytes_hash
from isetval.core.sensor import Exposure, Sensor
from isetval.files.dng.checks import clipping, clipping_remarks, describe_capture, line_remarks
from isetval.files.dng.decoding import decode
from isetval.files.dng.levels import Levels, active_area, read_levels
from isetval.files.dng.opcodes import gain_maps
from isetval.files.dng.optical_black import OpticalBlack, optical_black
from isetval.files.dng.refusal import Remark, check_not_constant, read_bytes, refusal
from isetval.files.dng.structure import check_layout
from isetval.files.dng.tags import LINEAR_RAW, Fractions, RawTags, cfa_letters, open_tags

BlackChoice = Literal["auto", "tag", "optical"]
# without the Exif focal-plane resolution the pitch is unknown; 1 um makes "mm" mean thousands of pixels
UNKNOWN_PITCH_UM = 1.0
CM_PER_UNIT = {2: Fraction(254, 100), 3: Fraction(1), 4: Fraction(1, 10), 5: Fraction(1, 10_000)}


@dataclass(frozen=True, eq=False)
class _Decoded:
    """What one pass over a file yields, before a black level is chosen."""

    mosaic: NDArray[np.uint16]
    cfa: str
    bits: int
    pixel_um: float
    levels: Levels
    margin: OpticalBlack | None
    exposure: Exposure
    metadata: dict[str, Any]
    remarks: list[Remark]


def read_dng(path: str | os.PathLike[str], *, black: BlackChoice = "auto") -> Capture:
    """Read a DNG into a capture whose window starts at (0, 0) of its own active area.

    Samples are as stored: not clipped, not white balanced, no shading correction applied.  All levels
    come from the tags.  Where the hidden margin of the frame holds plausible optical black that
    differs from the BlackLevel tag by more than three standard errors, the optical black is used
    (one value for each place of the 2x2 pattern) and ``provenance`` says so.  It is estimated for every
    file on its own; ``place_on_sensor`` puts the one black level of a campaign in its place.

    Parameters
    ----------
    path : path
    black : "auto", "tag" or "optical"
        Which black level to use; "optical" refuses a file without a plausible margin.

    Returns
    -------
    Capture
        ``provenance`` (JSON-able) holds ``file``, ``sha256``, ``black_used``, ``black_tag_dn``,
        ``black_dn``, ``optical_black``, ``warnings`` (code, message), ``make``, ``model``,
        ``software``, ``description``, ``date_time``, ``color_matrix``, ``as_shot_neutral``,
        ``noise_profile``, ``gain_maps``, ``focal_length_mm``, ``active_area``; None where absent.

    Raises
    ------
    InputError
        For a file that is not a whole Bayer or one-channel DNG with black and white level: the
        message says what was found, what is needed and what to do.
    """
    if black not in get_args(BlackChoice):
        raise InputError(f"black is {black!r}; it needs one of {', '.join(get_args(BlackChoice))}")
    data = read_bytes(path)
    decoded = _decode(path, data)
    table, used, remark = _choose_black(path, decoded, black)
    rows, cols = decoded.mosaic.shape
    sensor = Sensor(rows, cols, decoded.pixel_um, decoded.cfa, table, float(decoded.levels.white), decoded.bits)
    capture = Capture(decoded.mosaic, sensor, (0, 0), decoded.exposure)
    remarks = [*remark, *decoded.remarks, *clipping_remarks(clipping(capture)), *line_remarks(decoded.mosaic)]
    provenance = {
        "file": Path(path).name,
        "sha256": bytes_hash(data),
        "black_used": used,
        "black_dn": [list(row) for row in sensor.black_dn],
        "black_tag_dn": [list(row) for row in decoded.levels.black_dn],
        "optical_black": None if decoded.margin is None else asdict(decoded.margin),
        "warnings": tuple(asdict(r) for r in remarks),
        **decoded.metadata,
    }
    return Capture(decoded.mosaic, sensor, (0, 0), decoded.exposure, provenance)


def describe_file(path: str | os.PathLike[str], *, black: BlackChoice = "auto") -> dict[str, Any]:
    """What a DNG holds and what is doubtful about it, ready for JSON; see ``describe_capture``.

    Raises
    ------
    InputError
        As :func:`read_dng`.
    """
    return describe_capture(read_dng(path, black=black))


def _decode(path: object, data: bytes) -> _Decoded:
    with open_tags(path, data) as tags:
        layout = check_layout(path, tags, data)
        (top, left, bottom, right), remarks = active_area(path, tags, rows=layout.rows, cols=layout.cols)
        levels = read_levels(path, tags, shape=(bottom - top, right - left))
        frame = decode(path, data, tags, layout)
        mosaic = np.ascontiguousarray(frame[top:bottom, left:right])
        check_not_constant(path, mosaic, white=float(levels.white))
        area = (top, left, bottom, right)
        margin = optical_black(frame, area, black_dn=levels.black_dn, white_dn=float(levels.white))
        exposure, exposure_remarks = _exposure(tags)
        pitch_um, pitch_remarks = _pixel_pitch(tags)
        more, extra = _metadata(path, tags)
        return _Decoded(
            mosaic,
            "MONO" if int(tags.value(262)) == LINEAR_RAW else cfa_letters(bytes(tags.value(33422))),
            min(layout.bits, max(1, (int(levels.white)).bit_length())),
            pitch_um,
            levels,
            margin,
            exposure,
            {**extra, "active_area": list(area)},
            [*remarks, *levels.remarks, *more, *exposure_remarks, *pitch_remarks],
        )


def _choose_black(path: object, decoded: _Decoded, choice: BlackChoice) -> tuple[Any, str, list[Remark]]:
    """The black level to use, a word for it, and the sentence that says how far tag and margin differ."""
    margin = decoded.margin
    if choice == "optical" and (margin is None or margin.doubts):
        reason = (
            "no hidden margin" if margin is None else f"a hidden margin that is not optical black: {'; '.join(margin.doubts)}"
        )
        raise refusal(path, reason, "plausible optical black", "use the black level of the tag")
    if margin is None:
        return decoded.levels.black_dn, "tag", []
    tag_dn = float(np.mean(decoded.levels.black_dn))
    if margin.doubts:
        words = f"the hidden margin is not taken for optical black ({'; '.join(margin.doubts)})"
        words += f"; the tag's black level of {tag_dn:g} DN is used"
        return decoded.levels.black_dn, "tag", [Remark("margin_not_black", words)]
    optical_dn = float(np.mean(margin.mean_dn))
    apart = f"BlackLevel tag {tag_dn:g} DN, optical black {optical_dn:.2f} +- {margin.difference_sigma_dn:.2f} DN"
    apart += f" (it drifts by {margin.drift_dn:+.1f} DN across the margin)"
    if choice == "optical" or (choice == "auto" and margin.differs):
        words = f"{apart}: the tag is {_high_or_low(-margin.difference_dn)}; the optical black is used"
        return margin.mean_dn, "optical_black", [Remark("black_tag_differs", words)]
    if margin.differs:
        return decoded.levels.black_dn, "tag", [Remark("black_tag_differs", f"{apart}; the tag is used, as asked")]
    return decoded.levels.black_dn, "tag", []


def _high_or_low(excess_dn: float) -> str:
    return f"{abs(excess_dn):.2f} DN too {'high' if excess_dn > 0 else 'low'}"


def _float(value: Fraction | None) -> float | None:
    return None if value is None else float(value)


def _exposure(tags: RawTags) -> tuple[Exposure, list[Remark]]:
    time_s, f_number = (_float(tags.exif_number(code)) for code in (33434, 33437))
    # 65535 in the short tag means "see ISOSpeed, RecommendedExposureIndex or StandardOutputSensitivity" (Exif 2.3)
    sensitivities = [v for v in map(tags.exif_number, (34855, 34867, 34866, 34865)) if v is not None]
    iso = next((float(v) for v in sensitivities if v != 65535), 65535.0 if sensitivities else None)
    distance = tags.exif_number(37382)
    focus_m = float("inf") if distance is not None and distance >= 2**32 - 1 else _float(distance)
    missing = [name for name, value in (("ExposureTime", time_s), ("ISO", iso)) if value is None]
    remarks = [Remark("no_exposure", f"{' and '.join(missing)} absent or 0: taken as unknown")] if missing else []
    return Exposure(time_s, iso, f_number, focus_m), remarks


def _pixel_pitch(tags: RawTags) -> tuple[float, list[Remark]]:
    """Pitch in um from the Exif focal-plane resolution (pixels per unit)."""
    resolution, unit = tags.exif_number(41486), tags.exif_number(41488)
    if resolution is not None:
        pitch_um = 10_000 * CM_PER_UNIT.get(int(unit or 2), CM_PER_UNIT[2]) / resolution
        if Fraction(1, 10) < pitch_um < 100:
            return float(pitch_um), []
    words = f"no usable FocalPlaneXResolution: the pixel pitch is unknown and set to {UNKNOWN_PITCH_UM:g} um"
    words += ", so lengths in mm mean thousands of pixels"
    return UNKNOWN_PITCH_UM, [Remark("no_pixel_pitch", words)]


def _metadata(path: object, tags: RawTags) -> tuple[list[Remark], dict[str, Any]]:
    remarks = []
    if tags.tag(50830) is not None:
        remarks.append(
            Remark(
                "masked_areas", "MaskedAreas tag present: LibRaw would replace the BlackLevel by their mean, this reader does not"
            )
        )
    if tags.tag(50712) is not None:
        remarks.append(
            Remark("linearization_table", "LinearizationTable present: the samples are what it maps the stored codes to")
        )
    maps = []
    for code in (51008, 51009, 51022):
        value = tags.value(code)
        if value is not None:
            try:
                maps += [m.summary() for m in gain_maps(bytes(value))]
            except InputError as error:
                remarks.append(Remark("broken_opcodes", f"opcode list {code} is passed over: {error}"))
    if maps:
        remarks.append(Remark("gain_map", f"{len(maps)} GainMaps present: a proposed shading correction, not applied"))
    profile = tags.numbers(51041)
    return remarks, {
        "make": tags.text(271),
        "model": tags.text(272),
        "software": tags.text(305),
        "description": tags.text(270),
        "date_time": tags.text(306),
        "color_matrix": _floats(tags.numbers(50721)),
        "as_shot_neutral": _floats(tags.numbers(50728)),
        "noise_profile": None if not profile else [list(pair) for pair in _pairs(_floats(profile) or [])],
        "gain_maps": maps or None,
        "focal_length_mm": _float(tags.exif_number(37386)),
    }


def _floats(numbers: Fractions | None) -> list[float | None] | None:
    return None if numbers is None else [_float(v) for v in numbers]


def _pairs(values: Sequence[float | None]) -> list[tuple[float | None, float | None]]:
    return list(zip(values[::2], values[1::2], strict=False))
