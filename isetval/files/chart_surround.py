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
class ColorReader:
    """Reads R, G, B above black between the samples of a picture: ``picture`` (rows, cols, 3), of cells of ``cell_px`` pixels.

    ``sites`` (3, 2; row, col) are the mean places of the samples of each color in a cell, in pixels.
    """

    picture: Float
    cell_px: int
    sites: Float

    @classmethod
    def of(cls, capture: Capture) -> ColorReader:
        """Of a capture; a full frame is binned once."""
        from isetval.measure.color.chart_finding import preview

        cfa = capture.sensor.cfa
        if cfa == "MONO":
            return cls(preview(capture, 1), 1, np.zeros((3, 2)))
        sites = [np.mean([divmod(i, 2) for i, c in enumerate(cfa) if c == color], axis=0) for color in "RGB"]
        return cls(preview(capture, 2), 2, np.array(sites))

    def __call__(self, places_px: Float) -> Float:
        """Levels (n, 3) at places (n, 2; column, row) in pixels, linear between samples."""
        from scipy.ndimage import map_coordinates

        places = [(places_px[:, ::-1] - site).T / self.cell_px for site in self.sites]
        each = [map_coordinates(self.picture[..., k], at, order=1, mode="nearest") for k, at in enumerate(places)]
        return np.stack(each, axis=1)


@dataclass(frozen=True, eq=False)
class ChartSurround:
    """How bright the board between patches and what is behind the chart are, in shares of the white patch; the board's box.

    ``behind`` and ``outline`` are None where the board goes on as far as the picture of the chart does.
    """

    board: float
    behind: float | None = None
    outline: RoiLike | None = None


def chart_surround(see: ColorReader, to_pixels: Callable[[Float], Float], side: float, white_dn: Float) -> ChartSurround | None:
    """The surround of a registered 24-patch chart, or None where the gaps are too narrow to tell.

    Parameters
    ----------
    see : ColorReader
        Of the picture.
    to_pixels : callable
        Projects (n, 2; column, row) in patch pitches, the first patch's middle at (0, 0), to pixels.
    side : float
        Of a patch, in pitches.
    white_dn : array (3,)
        R, G, B of the white patch above black; a share is the factor of it that comes nearest: colors that a narrow light leaves
        without signal say nothing.
    """
    pitch = float(np.median(np.hypot(*np.diff(to_pixels(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])), axis=0).T)))
    if (1 - side) * pitch < LEAST_GAP_PX or not white_dn.max() > 0:
        return None
    # where gaps cross, patches are farthest: the middle half of each crossing
    near = (1 - side) / 4 * np.linspace(-1, 1, 5)
    crossings = np.array(
        [[i + 0.5 + dx, j + 0.5 + dy] for i in range(COLUMNS - 1) for j in range(ROWS - 1) for dx in near for dy in near]
    )
    board = np.median(see(to_pixels(crossings)), axis=0)

    def share(level_dn: Float) -> float:
        return float(level_dn @ white_dn / (white_dn @ white_dn))

    ends, behind = [], []
    for along, rim in _rims():
        start = rim + side / 2 * along
        across = 0.25 * along[::-1] * np.linspace(-1, 1, 5)[:, None]
        rays = start[:, None, None] + across[None, :, None] + BEYOND[:, None] * along
        profile = np.median(see(to_pixels(rays.reshape(-1, 2))).reshape(-1, BEYOND.size, 3), axis=0)
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
    on_board = np.flatnonzero(share < 0.5)  # the blur of a bright patch reaches out over the board's first samples
    end = min(int(on_board[-1]) + 1, BEYOND.size - 1) if on_board.size else 0
    return float(BEYOND[end]), behind
