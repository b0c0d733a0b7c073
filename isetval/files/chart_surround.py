"""What lies between and around a chart's patches, read off the picture: the board's level, where it ends, and what is behind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture
from isetval.core.sensor import RoiLike

Float = NDArray[np.float64]
COLUMNS, ROWS = 6, 4
LEAST_GAP_PX = 5.0  # the blur of a lens in focus leaves a pixel of the board between patches
BEYOND = np.arange(0.0, 1.0001, 0.01)  # pitches outwards from the outer patches' borders: as far as a draft's window reaches
CLEAR = 0.02  # of the white patch: a table or wall that differs by less from the board is drafted as it


@dataclass(frozen=True, eq=False)
class ChartSurround:
    """How bright the board between patches and what is behind the chart are, in shares of the white patch; the board's box.

    ``behind`` and ``outline`` are None where the board goes on as far as the picture of the chart does.
    """

    board: float
    behind: float | None = None
    outline: RoiLike | None = None


def chart_surround(capture: Capture, to_pixels: Callable[[Float], Float], side: float, white_dn: Float) -> ChartSurround | None:
    """The surround of a registered 24-patch chart, or None where the gaps are too narrow to tell.

    Parameters
    ----------
    capture : Capture
    to_pixels : callable
        Projects (n, 2; column, row) in patch pitches, the first patch's middle at (0, 0), to pixels.
    side : float
        Of a patch, in pitches.
    white_dn : array (3,)
        R, G, B of the white patch above black; shares are the median of the three.
    """
    see = _reader(capture, to_pixels)
    pitch = float(np.median(np.hypot(*np.diff(to_pixels(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])), axis=0).T)))
    if (1 - side) * pitch < LEAST_GAP_PX:
        return None
    # where gaps cross, patches are farthest: the middle half of each crossing
    near = (1 - side) / 4 * np.linspace(-1, 1, 5)
    crossings = np.array(
        [[i + 0.5 + dx, j + 0.5 + dy] for i in range(COLUMNS - 1) for j in range(ROWS - 1) for dx in near for dy in near]
    )
    board = np.median(see(crossings), axis=0)

    def share(level_dn: Float) -> float:
        return float(np.median(level_dn / white_dn))

    ends, behind = [], []
    for along, rim in _rims():
        start = rim + side / 2 * along
        across = 0.25 * along[::-1] * np.linspace(-1, 1, 5)[:, None]
        rays = start[:, None, None] + across[None, :, None] + BEYOND[:, None] * along
        profile = np.median(see(rays.reshape(-1, 2)).reshape(-1, BEYOND.size, 3), axis=0)
        found = _end_of_board(profile, board, CLEAR * float(white_dn.max()))
        ends.append(side / 2 + (BEYOND[-1] if found is None else found[0]))
        behind += [] if found is None else [found[1]]
    if not behind:
        return ChartSurround(share(board))
    right, below, left, above = ends
    corners = [[-left, -above], [COLUMNS - 1 + right, -above], [COLUMNS - 1 + right, ROWS - 1 + below], [-left, ROWS - 1 + below]]
    col, row = to_pixels(np.array(corners)).T  # from the upper left, clockwise; a side that leans is taken at its middle
    box = (row[:2].mean(), row[2:].mean(), col[[0, 3]].mean(), col[1:3].mean())
    row0, row1, col0, col1 = (round(float(end)) for end in box)
    return ChartSurround(share(board), share(np.median(behind, axis=0)), (row0, row1, col0, col1))


def _rims() -> list[tuple[Float, Float]]:
    """Directions outwards (2,), to the right, below, to the left and above, and the middles (n, 2) of the patches there."""
    rows, columns = np.arange(ROWS), np.arange(COLUMNS)
    lines = (
        ((1, 0), [(COLUMNS - 1, j) for j in rows]),
        ((0, 1), [(i, ROWS - 1) for i in columns]),
        ((-1, 0), [(0, j) for j in rows]),
        ((0, -1), [(i, 0) for i in columns]),
    )
    return [(np.array(along, float), np.array(middles, float)) for along, middles in lines]


def _end_of_board(profile: Float, board: Float, clear_dn: float) -> tuple[float, Float] | None:
    """How far out (pitches) the board's level gives way to another, halfway, and that level; None where it goes on."""
    behind = np.median(profile[-len(profile) // 8 :], axis=0)
    k = int(np.argmax(np.abs(behind - board)))
    if abs(behind[k] - board[k]) < clear_dn:
        return None
    share = (profile[:, k] - board[k]) / (behind[k] - board[k])
    return float(BEYOND[int(np.flatnonzero(share < 0.5)[-1]) + 1 if np.any(share < 0.5) else 0]), behind


def color_sites(cfa: str) -> Float:
    """Mean place (3, 2; row, col) of the samples of R, G, B in a cell of the preview, in pixels."""
    if cfa == "MONO":
        return np.zeros((3, 2))
    return np.array([np.mean([divmod(i, 2) for i, c in enumerate(cfa) if c == color], axis=0) for color in "RGB"])


def _reader(capture: Capture, to_pixels: Callable[[Float], Float]) -> Callable[[Float], Float]:
    """R, G, B above black, (n, 3), at places (n, 2) in pitches."""
    from scipy.ndimage import map_coordinates

    from isetval.measure.color.chart_finding import preview

    bin_px = 1 if capture.sensor.cfa == "MONO" else 2
    picture, sites = preview(capture, bin_px), color_sites(capture.sensor.cfa)

    def see(points: Float) -> Float:
        places = to_pixels(points)[:, ::-1]
        each = [
            map_coordinates(picture[..., k], ((places - site) / bin_px).T, order=1, mode="nearest")
            for k, site in enumerate(sites)
        ]
        return np.stack(each, axis=1)

    return see
