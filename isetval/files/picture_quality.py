"""What a raw mosaic itself says about its quality: clipping, stuck or deviating lines, codes that never occur."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, plane_black_dn, plane_view, planes_of
from isetval.files.bad_pixels import bad_pixels
from isetval.files.picture_file import Remark
from isetval.measure.noise.code_counts import CodeCounts, code_counts

Mosaic = NDArray[np.uint16]

NEIGHBORS = 8  # lines of one CFA phase that a rim line is held against: enough for a median, near enough to be alike
OUTLIER_SIGMAS = 8.0  # a normal pixel goes there once in 10^15: none of a 12 MP frame does by chance
MISSING_CODES_LISTED = 16  # a sentence, not a table
COMMON_COUNT = 30  # a Poisson count of mean 30 is 0 with probability 1e-13
WIDEST_GAP = 15  # the gaps of a shift by four bits (12 bits stored as 16), the widest in use
CLIPPED_SHARE_NAMED = 1e-4  # ten hot or dead pixels in 10^5 are ordinary
STRIP_BYTES = 1 << 18  # some arrays of this size stay in the second-level cache of common processors
NORMAL_MAD = 1.4826  # standard deviation over median absolute deviation of a normal distribution


@dataclass(frozen=True)
class Clipping:
    """Pixels of one color plane at the ends of the scale: counts, and shares of the plane."""

    plane: str
    pixels: int
    at_zero: int
    at_white: int

    @property
    def share_at_zero(self) -> float:
        """Share of the plane's pixels that are 0."""
        return self.at_zero / self.pixels if self.pixels else 0.0

    @property
    def share_at_white(self) -> float:
        """Share of the plane's pixels at or above the white level."""
        return self.at_white / self.pixels if self.pixels else 0.0


def clipping(capture: Capture) -> tuple[Clipping, ...]:
    """Pixels of every color plane at 0, and at or above the white level."""
    white_dn = capture.sensor.white_dn
    # most pictures have no such pixel at all, and one look at the frame is quicker than eight at planes
    lowest, highest = extremes(capture.mosaic)
    if lowest > 0 and highest < white_dn:
        return tuple(Clipping(plane, plane_view(capture, plane)[0].size, 0, 0) for plane in planes_of(capture))
    return clipping_of(code_counts(capture), white_dn)


def clipping_of(counts: Mapping[str, CodeCounts], white_dn: float) -> tuple[Clipping, ...]:
    """The same from the counts of the planes' codes."""
    return tuple(Clipping(plane, c.pixels, c.at_zero, c.from_code(white_dn)) for plane, c in counts.items())


def extremes(mosaic: Mosaic) -> tuple[int, int]:
    """Smallest and largest code, some rows at a time: they come from memory once."""
    rows = max(1, STRIP_BYTES // max(2 * mosaic.shape[1], 1))
    strips = [mosaic[row : row + rows] for row in range(0, mosaic.shape[0], rows)]
    found = [(int(strip.min()), int(strip.max())) for strip in strips]
    return min(low for low, _ in found), max(high for _, high in found)


def clipping_remarks(counts: tuple[Clipping, ...]) -> list[Remark]:
    """Sentences for planes with more than 1 pixel in 10 000 clipped."""
    remarks = []
    for code, end, share in (
        ("clipped_at_zero", "0", "share_at_zero"),
        ("clipped_at_white", "or above the white level", "share_at_white"),
    ):
        parts = [f"{c.plane} {getattr(c, share):.1%}" for c in counts if getattr(c, share) > CLIPPED_SHARE_NAMED]
        if parts:
            tail = "; noise and mean of dark pixels are not what they seem" if code == "clipped_at_zero" else ""
            remarks.append(Remark(code, f"pixels at {end}: {', '.join(parts)}{tail}"))
    return remarks


def line_remarks(mosaic: Mosaic) -> list[Remark]:
    """First and last rows and columns that are constant, or whose mean stands out of their neighbors'."""
    rows, cols = mosaic.shape
    remarks: list[Remark] = []
    if min(rows, cols) < 4 * NEIGHBORS:
        return remarks
    for axis, name in ((0, "row"), (1, "column")):
        lines = mosaic if axis == 0 else mosaic.T
        for index in (0, lines.shape[0] - 1):
            words = _odd_line(lines, index)
            if words:
                remarks.append(Remark(f"outlier_{name}", f"{name} {index} {words}; leave it out of every region"))
    return remarks


def _odd_line(lines: Mosaic, index: int) -> str | None:
    """Hold the step from a rim line to the next line of its CFA phase against the steps behind it.

    A picture's own structure (gradients, texture, row noise) makes all steps alike; a bad line makes
    the first one stand out.
    """
    phase = lines[index :: 2 if index == 0 else -2][: NEIGHBORS + 1].astype(np.float32)  # holds codes and halves exactly
    line, behind = phase[0], phase[1:]
    # a chance of 1e-6 that pixels like those behind would all have one value
    if np.ptp(line) == 0 and line.size * np.log1p(-min(float(np.mean(behind != line[0])), 0.999)) < np.log(1e-6):
        return f"holds {int(line[0])} everywhere"
    steps = np.diff(phase, axis=0)
    middles = np.median(steps, axis=1)
    noise = max(float(NORMAL_MAD * np.median(np.abs(steps[1:] - middles[1:, None]))), 0.5)
    shift, *usual_shift = middles.tolist()
    scatter = noise * np.sqrt(np.pi / 2 / line.size)
    if abs(shift) > max(OUTLIER_SIGMAS * scatter, 4 * max(map(abs, usual_shift)), 1.0):
        return f"lies {-shift:+.1f} DN from its neighbors"
    share, *usual_share = np.mean(np.abs(steps) > OUTLIER_SIGMAS * noise, axis=1).tolist()
    if share > max(0.1, 4 * max(usual_share)):
        return f"holds garbage: {share:.0%} of its pixels lie more than {OUTLIER_SIGMAS:g} sigma from their neighbors"
    return None


@dataclass(frozen=True)
class Codes:
    """Use of the DN scale: ``missing`` are values between the lowest and the highest common one that never occur."""

    lowest: int
    highest: int
    median: float
    missing: tuple[int, ...]
    missing_count: int


def code_use(mosaic: Mosaic) -> Codes:
    """Codes that never occur although their neighbors are common.

    Only values between the 0.1 % and 99 % quantile are judged, and only gaps of at most 15 codes (a
    shift by four bits) whose two ends occur at least 30 times each: a Poisson count of mean 30 is
    zero with probability 1e-13, while the tails of a picture thin out before they end.
    """
    return code_use_of(np.bincount(mosaic.ravel(), minlength=2))


def code_use_of(counts: NDArray[np.int64]) -> Codes:
    """The same from how often each code occurs."""
    total = np.cumsum(counts)
    quantile = np.searchsorted(total, np.array([0.001, 0.5, 0.99]) * total[-1])
    used = np.flatnonzero(counts)
    inside = np.arange(quantile[0], quantile[2] + 1)
    gaps = inside[counts[inside] == 0]
    at = np.searchsorted(used, gaps)
    below, above = used[np.maximum(at - 1, 0)], used[np.minimum(at, len(used) - 1)]
    missing = gaps[(np.minimum(counts[below], counts[above]) >= COMMON_COUNT) & (above - below <= WIDEST_GAP + 1)]
    listed = tuple(int(v) for v in missing[:MISSING_CODES_LISTED])
    return Codes(int(used[0]), int(used[-1]), float(quantile[1]), listed, len(missing))


def code_remarks(codes: Codes) -> list[Remark]:
    """A sentence if values never occur."""
    if not codes.missing_count:
        return []
    listed = ", ".join(map(str, codes.missing)) + (" ..." if codes.missing_count > len(codes.missing) else "")
    text = f"{codes.missing_count} values inside the used range never occur ({listed}): "
    text += "the data were stretched or calibrated after the converter"
    return [Remark("missing_codes", text)]


def describe_capture(capture: Capture) -> dict[str, Any]:
    """Everything this module can say about a capture, ready for JSON.

    Returns
    -------
    dict
        ``shape`` (rows, cols), ``cfa``, ``black_dn`` (per plane), ``white_dn``, ``exposure``,
        ``clipped`` (per plane: counts and shares), ``bad_pixels`` (hot, dead), ``codes``
        (lowest, highest, median, missing), ``warnings`` (code, message), ``provenance``.
    """
    used = code_counts(capture)
    counts = clipping_of(used, capture.sensor.white_dn)
    codes = code_use_of(np.sum([c.counts for c in used.values()], axis=0))
    remarks = [*_stored(capture), *clipping_remarks(counts), *line_remarks(capture.mosaic), *code_remarks(codes)]
    unique = list(dict.fromkeys(remarks))
    focus_m = capture.exposure.focus_m
    return {
        "shape": list(capture.mosaic.shape),
        "cfa": capture.sensor.cfa,
        "bits": capture.sensor.bits,
        "black_dn": {plane: plane_black_dn(capture, plane) for plane in planes_of(capture)},
        "white_dn": capture.sensor.white_dn,
        "exposure": asdict(capture.exposure) | ({"focus_m": "infinity"} if focus_m == np.inf else {}),
        "clipped": {c.plane: asdict(c) | {"share_at_zero": c.share_at_zero, "share_at_white": c.share_at_white} for c in counts},
        "bad_pixels": bad_pixels(capture),
        "codes": asdict(codes),
        "warnings": [asdict(r) for r in unique],
        "provenance": {k: v for k, v in capture.provenance.items() if k != "warnings"},
    }


def _stored(capture: Capture) -> list[Remark]:
    return [Remark(w["code"], w["message"]) for w in capture.provenance.get("warnings", ())]
