"""Find slanted edges in a capture: straight or gently bent contours with clear ground on both sides.

No threshold to tune: gradients are compared with their own noise at their own level, distances with
the edge's own width.  Every candidate that is dropped keeps its reason.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, black_image_dn, plane_view
from isetval.core.errors import InputError
from isetval.core.jsonable import plain
from isetval.core.sensor import RoiLike
from isetval.core.shown import Drawn
from isetval.core.threads import one_blas_thread
from isetval.measure.edge.contours import Segment, find_segments
from isetval.measure.edge.measure_regions import sfr
from isetval.measure.edge.samples import MIN_SIDE_PX, check_channel

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.floating[Any]]

# Tried with half and twice the value as in ``contours``: two charts of 40 edges, a real frame of 16
MIN_LENGTH_PX = 30.0  # just above the least side of a region (24 px, 28 for greens); twice of it loses 4 of 16
MIN_CLEAR_PX = 10.0  # the fit needs plateaus on both sides: 4 widths of an edge of 2.5 px; twice of it loses 3 of 16
MAX_PIECE_PX = 260.0  # longer contours are cut: bent edges are followed by a polynomial of order 5, distortion by pieces
MAX_CLEAR_PX = 90.0  # more ground adds little and takes time; no effect
MIN_ANGLE_DEG = 1.0  # an edge of 60 px crosses one pixel then: all phases are seen (``sfr`` refuses from .75 on)
CLEAR_LEVEL = 0.15  # of the step, just above what ``sfr`` refuses (``verdict.SECOND_EDGE``); half finds 20 and 3, twice 41 and 28
MAX_SHADING = 0.7  # change of a level along the edge, of the step: more is a second structure; half loses 1 of 16
PATTERN_COUNT = 4  # a square has one parallel side, a frame three; no effect in the charts (bar codes have 10 or more)
PATTERN_REACH = 0.6  # of the length: neighbours farther away leave a region of their own; twice loses 1 of 16


class EdgeRoi(tuple[int, int, int, int]):
    """A region (row0, row1, col0, col1), half open, with one slanted edge; give it to ``sfr`` as it is.

    ``angle_deg`` from the nearer pixel axis, ``row_px``/``col_px`` the middle of the edge, ``length_px``,
    ``normal_deg`` the direction from dark to bright (0: towards larger columns, 90: larger rows).
    """

    angle_deg: float
    normal_deg: float
    row_px: float
    col_px: float
    length_px: float

    def __new__(cls, roi: Iterable[int], segment: Segment) -> EdgeRoi:
        """Region of a segment."""
        self = super().__new__(cls, (int(v) for v in roi))
        self.normal_deg = segment.normal_deg
        folded = (segment.normal_deg + 45) % 90 - 45
        self.angle_deg = float(folded)
        self.row_px, self.col_px, self.length_px = segment.row_px, segment.col_px, segment.length_px
        return self


@dataclass(frozen=True)
class RejectedEdge:
    """A candidate that was dropped, and why."""

    roi: RoiLike
    reason: str
    message: str
    row_px: float
    col_px: float
    length_px: float


class FoundEdges(Drawn, list[EdgeRoi]):
    """Regions of slanted edges; ``rejected`` holds the candidates that were dropped, with reasons."""

    def __init__(self, accepted: Iterable[EdgeRoi] = (), rejected: Iterable[RejectedEdge] = ()) -> None:
        super().__init__(accepted)
        self.rejected: list[RejectedEdge] = list(rejected)

    def headline(self) -> str:
        """How many, and the reasons against the others."""
        reasons = Counter(edge.reason for edge in self.rejected).most_common()
        against = f": {', '.join(f'{count} {reason}' for reason, count in reasons)}" if reasons else ""
        return f"{len(self)} edges, {len(self.rejected)} rejected{against}"

    def to_frame(self) -> pd.DataFrame:
        """One row a region: row0, row1, col0, col1, reason (empty: accepted), row_px, col_px, length_px, angle_deg."""
        import pandas as pd

        rows = [(*edge, "", edge.row_px, edge.col_px, edge.length_px, edge.angle_deg) for edge in self]
        rows += [(*edge.roi, edge.reason, edge.row_px, edge.col_px, edge.length_px, math.nan) for edge in self.rejected]
        names = ["row0", "row1", "col0", "col1", "reason", "row_px", "col_px", "length_px", "angle_deg"]
        return pd.DataFrame(rows, columns=names)

    def to_json(self) -> list[dict[str, Any]]:
        """The rows of the table."""
        rows: list[dict[str, Any]] = plain(self.to_frame().to_dict(orient="records"))
        return rows


@one_blas_thread()
def find_edges(capture: Capture, channel: str = "G") -> FoundEdges:
    """Find the slanted edges of squares, bars and blades.

    Parameters
    ----------
    capture : Capture
    channel : str
        Channel that the regions will be measured in (each region is tried with ``sfr``).

    Returns
    -------
    FoundEdges
        A list of ``EdgeRoi`` in reading order, with ``.rejected``: reasons ``too_short``, ``angle``
        (nearer than 1 degree to a pixel axis or to 45 degrees), ``crowded`` (other structure closer than
        10 px or 4 edge widths: text, bar codes, corners), ``pattern`` (one of many parallel lines), ``not_straight``,
        ``too_small``, and the codes of ``sfr``.
    """
    if not isinstance(capture, Capture):
        raise InputError(f"find_edges needs a Capture, not {type(capture).__name__}; see Capture.from_array")
    check_channel(capture, channel)
    if min(capture.mosaic.shape) < 24:
        return FoundEdges()
    image, scale = working_image(capture)
    segments = find_segments(image)
    crowd = _parallel_neighbours(segments)
    accepted: list[EdgeRoi] = []
    rejected: list[RejectedEdge] = []
    for segment, neighbours in zip(segments, crowd, strict=True):
        for piece in _pieces(segment, scale):
            outcome = _try_piece(capture, channel, image, scale, piece=piece, neighbours=neighbours)
            if isinstance(outcome, EdgeRoi):
                accepted.append(outcome)
            else:
                rejected.append(outcome)
    accepted = _without_doubles(accepted, rejected)
    return FoundEdges(sorted(accepted, key=lambda e: (e[0], e[2])), rejected)


def working_image(capture: Capture) -> tuple[Float, float]:
    """Image in which edges are looked for, and capture pixels per image pixel: greens of 2 x 2 cells, or the image itself."""
    if capture.sensor.cfa == "MONO":
        return capture.mosaic - black_image_dn(capture), 1.0
    total: Any = 0.0
    rows, cols = (n // 2 for n in capture.mosaic.shape)
    for name in ("Gr", "Gb"):
        view, _, _ = plane_view(capture, name)
        total = total + view[:rows, :cols].astype(float)
    black = capture.sensor.black_dn
    return np.asarray(total / 2 - (sum(map(sum, black)) / 4)), 2.0


def _parallel_neighbours(segments: list[Segment]) -> list[int]:
    """Number of parallel segments beside each one, within 0.6 lengths."""
    out = []
    middle = np.array([[s.row_px, s.col_px] for s in segments]).reshape(-1, 2)
    angle = np.array([s.normal_deg % 180 for s in segments])
    length = np.array([s.length_px for s in segments])
    for i, segment in enumerate(segments):
        turn = np.abs((angle - angle[i] + 90) % 180 - 90) < 3
        radians = np.radians(segment.normal_deg)
        normal = np.array([np.sin(radians), np.cos(radians)])
        offset = middle - middle[i]
        across = np.abs(offset @ normal)
        along = np.abs(offset @ np.array([normal[1], -normal[0]]))
        beside = turn & (across < PATTERN_REACH * segment.length_px) & (across > 1) & (along < 0.4 * length[i] + 0.2 * length)
        out.append(int(np.sum(beside & (length > 0.4 * length[i]))))
    return out


def _pieces(segment: Segment, scale: float) -> list[Segment]:
    """The segment in pieces no longer than ``MAX_PIECE_PX`` capture pixels."""
    number = int(np.ceil(segment.length_px * scale / MAX_PIECE_PX))
    if number <= 1:
        return [segment]
    places = (np.arange(number) + 0.5) / number - 0.5
    return [segment.part(place, 1 / number) for place in places]


def _try_piece(
    capture: Capture, channel: str, image: Float, scale: float, *, piece: Segment, neighbours: int
) -> EdgeRoi | RejectedEdge:
    full = piece.scaled(scale)
    box = _bounding(capture, full)

    def drop(reason: str, message: str, roi: RoiLike = box) -> RejectedEdge:
        return RejectedEdge(roi, reason, message, full.row_px, full.col_px, full.length_px)

    if full.length_px < MIN_LENGTH_PX:
        return drop("too_short", f"{full.length_px:.0f} px long; needs {MIN_LENGTH_PX:g}")
    folded = abs((full.normal_deg + 45) % 90 - 45)
    if not MIN_ANGLE_DEG <= folded <= 45 - MIN_ANGLE_DEG:
        return drop("angle", f"{folded:.2f} degrees from a pixel axis; needs {MIN_ANGLE_DEG:g} to {45 - MIN_ANGLE_DEG:g}")
    if piece.bend_px > 0.06 * piece.length_px + 1:
        return drop("not_straight", f"bends by {piece.bend_px * scale:.1f} px over {full.length_px:.0f} px")
    if neighbours >= PATTERN_COUNT:
        return drop("pattern", f"{neighbours} parallel lines beside it: a bar code, text or a grating")
    clear = clear_width(image, piece) * scale
    need = max(MIN_CLEAR_PX, 4 * piece.width_px * scale)
    if clear < need:
        return drop("crowded", f"other structure {clear:.1f} px from the edge; needs {need:.1f}")
    roi = place_roi(
        capture,
        full,
        least=MIN_SIDE_PX[check_channel(capture, channel)],
        clear_px=min(clear, MAX_CLEAR_PX, max(0.75 * full.length_px, need)),
    )
    if roi is None:
        return drop("too_small", f"no upright region fits {full.length_px:.0f} x {2 * clear:.0f} px at {folded:.0f} degrees")
    result = sfr(capture, roi, channel)
    if result.flags:
        return drop(result.flags[0], result.messages[result.flags[0]], roi)
    return EdgeRoi(roi, full)


def clear_width(image: Float, segment: Segment) -> float:
    """Distance on both sides up to which the levels stay those of the edge, image pixels."""
    from scipy.ndimage import map_coordinates

    half = 0.5 * segment.length_px - segment.margin_px
    along = np.linspace(-half, half, max(12, int(half)))
    reach = min(60.0, max(8.0, 1.2 * segment.length_px))
    across = np.arange(-reach, reach + 0.5, 1.0)
    radians = np.radians(segment.normal_deg)
    normal = np.array([np.sin(radians), np.cos(radians)])
    tangent = np.array([normal[1], -normal[0]])
    bow = segment.bow(along)
    place = (
        np.array([segment.row_px, segment.col_px])[:, None, None]
        + tangent[:, None, None] * along[None, :, None]
        + normal[:, None, None] * (across[None, None, :] + bow[None, :, None])
    )
    values = map_coordinates(image, place, order=1, mode="constant", cval=np.nan)
    near = max(2.0, 2.5 * segment.width_px)
    outside = np.flatnonzero(np.isnan(values).sum(axis=0) > 0.02 * len(values))
    quarter = max(1, len(along) // 8)
    blocks = np.array(
        [np.nanmean(_filled(part), axis=0) for part in np.array_split(values, max(1, len(along) // quarter), axis=0)]
    )
    levels = [_trend(blocks[:, np.abs(across - side * (near + 1.5)) <= 1.5].mean(axis=1)) for side in (-1, 1)]
    step = abs(float(np.mean(levels[1] - levels[0])))
    if step <= 0 or max(float(np.ptp(level)) for level in levels) > MAX_SHADING * step:
        return 0.0
    extents = []
    for side, level in zip((-1, 1), levels, strict=True):
        order = np.argsort(side * across)
        order = order[(side * across[order]) > near]
        worst = np.abs(blocks[:, order] - level[:, None]).max(axis=0)
        # shading may change the level along the way; half of the step is another structure
        limit = max(CLEAR_LEVEL, 3 * segment.noise / step) * step
        blocked = np.flatnonzero((worst > limit) | np.isin(order, outside))
        stop = int(blocked[0]) if len(blocked) else len(order)
        extents.append(float(np.abs(across[order[stop - 1]])) if stop > 0 else near)
    return min(extents)


def _trend(level: Float) -> Float:
    """Straight line through levels along the edge: shading is no structure."""
    place = np.arange(len(level)) - (len(level) - 1) / 2
    return np.asarray(level.mean() + place * ((place @ level) / max(float(place @ place), 1.0)))


def _filled(part: Float) -> Float:
    """The block without columns that are all NaN (outside the image)."""
    gone = np.asarray(np.isnan(part).all(axis=0))
    return np.asarray(np.where(gone[None, :], 0.0, part))


def place_roi(capture: Capture, segment: Segment, *, clear_px: float, least: int) -> RoiLike | None:
    """Largest upright rectangle inside the clear band, centred on the edge; None if a side is below ``least`` px."""
    theta = np.radians(abs((segment.normal_deg + 45) % 90 - 45))
    half_length = 0.5 * segment.length_px - segment.margin_px
    along = np.arange(float(least), segment.length_px + 1)
    sine, cosine = max(float(np.sin(theta)), 1e-9), float(np.cos(theta))
    across = np.minimum(2 * (clear_px - along / 2 * sine) / cosine, 2 * (half_length - along / 2 * cosine) / sine)
    across = np.minimum(across, 1.5 * clear_px + along * sine)
    value = np.where(across >= least, along * np.sqrt(np.maximum(across, 0)), -1.0)
    if value.size == 0 or value.max() <= 0:
        return None
    best = int(np.argmax(value))
    height, width = along[best], across[best]
    if 45 < segment.normal_deg % 180 < 135:
        height, width = width, height
    rows, cols = capture.mosaic.shape
    row0, row1 = round(segment.row_px - height / 2), round(segment.row_px + height / 2)
    col0, col1 = round(segment.col_px - width / 2), round(segment.col_px + width / 2)
    row0, col0, row1, col1 = max(row0, 0), max(col0, 0), min(row1, rows), min(col1, cols)
    return None if min(row1 - row0, col1 - col0) < least else (row0, row1, col0, col1)


def _bounding(capture: Capture, segment: Segment) -> RoiLike:
    radians = np.radians(segment.normal_deg)
    rows, cols = capture.mosaic.shape
    high = abs(np.cos(radians)) * segment.length_px / 2 + 4
    wide = abs(np.sin(radians)) * segment.length_px / 2 + 4
    row0, col0 = max(0, int(segment.row_px - high)), max(0, int(segment.col_px - wide))
    return (
        row0,
        max(row0 + 1, min(rows, int(segment.row_px + high) + 1)),
        col0,
        max(col0 + 1, min(cols, int(segment.col_px + wide) + 1)),
    )


def _without_doubles(accepted: list[EdgeRoi], rejected: list[RejectedEdge]) -> list[EdgeRoi]:
    """Drop regions whose edge passes where a longer accepted one does."""
    kept: list[EdgeRoi] = []
    for edge in sorted(accepted, key=lambda e: -e.length_px):
        radians = np.radians(edge.normal_deg)
        double = False
        for other in kept:
            row, col = other.row_px - edge.row_px, other.col_px - edge.col_px
            across = abs(row * np.sin(radians) + col * np.cos(radians))
            along = abs(row * np.cos(radians) - col * np.sin(radians))
            turn = abs((other.normal_deg - edge.normal_deg + 180) % 360 - 180)
            double |= bool(turn < 10 and across < 4 and along < 0.3 * (edge.length_px + other.length_px))
        if double:
            rejected.append(
                RejectedEdge(
                    (edge[0], edge[1], edge[2], edge[3]),
                    "double",
                    "the same edge was found longer",
                    edge.row_px,
                    edge.col_px,
                    edge.length_px,
                )
            )
        else:
            kept.append(edge)
    return kept
