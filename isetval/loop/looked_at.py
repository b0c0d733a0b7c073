"""The parts of a large frame that its estimators look at: all that has to be simulated of it."""

from __future__ import annotations

from collections.abc import Sequence

from isetval.core.campaign import Shot
from isetval.core.scene import RenderedTarget
from isetval.core.sensor import Roi, Sensor
from isetval.measure.campaign import regions_read

LARGE_PX = 200_000  # below it a frame is done sooner than its parts
WORTH = 0.5  # share of the frame: more would save little
MARGIN_PX = 16  # beyond a region: as far as any effect on neighbours reaches (`halo_px`)


def looked_at(shot: Shot, sensor: Sensor) -> tuple[Roi, ...]:
    """Regions (row0, row1, col0, col1) of the shot's window that are looked at, with a margin; none where that is most of it."""
    rows, cols = (shot.window or (0, 0, sensor.rows, sensor.cols))[2:]
    if rows * cols < LARGE_PX or shot.given is not None or isinstance(shot.target, RenderedTarget):
        return ()
    asked = regions_read(shot)
    if not asked:
        return ()
    grown = [
        Roi(max(r.row0 - MARGIN_PX, 0), min(r.row1 + MARGIN_PX, rows), max(r.col0 - MARGIN_PX, 0), min(r.col1 + MARGIN_PX, cols))
        for r in asked
    ]
    found = merged([r for r in grown if r.row0 < r.row1 and r.col0 < r.col1])
    return found if sum(map(_area, found)) < WORTH * rows * cols else ()


def merged(regions: Sequence[Roi]) -> tuple[Roi, ...]:
    """Regions that share no pixel: those that did are replaced by the box around them."""
    out: list[Roi] = []
    for region in regions:
        new = region
        while touching := [other for other in out if _overlap(new, other)]:
            out = [other for other in out if other not in touching]
            every = [new, *touching]
            new = Roi(
                min(r.row0 for r in every), max(r.row1 for r in every), min(r.col0 for r in every), max(r.col1 for r in every)
            )
        out.append(new)
    return tuple(sorted(out))


def _overlap(a: Roi, b: Roi) -> bool:
    return a.row0 < b.row1 and b.row0 < a.row1 and a.col0 < b.col1 and b.col0 < a.col1


def _area(region: Roi) -> int:
    return (region.row1 - region.row0) * (region.col1 - region.col0)
