"""Line sums of whole captures: each set-up is gone through once, for all colour planes together."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

from isetval.core.capture import Capture, Roi, check_roi, plane_black_dn, plane_view, planes_of
from isetval.measure.noise.linesums import LineSums, line_sums

THREADED_PIXELS = 1_000_000


@dataclass(eq=False)
class Passes:
    """Line sums by set-up (told by its first capture) and plane, made when first asked for.

    ``black_dn`` by plane serves the column profile of the light; default the captures' own black level.
    """

    roi: Roi | None
    black_dn: Mapping[str, float] = field(default_factory=dict)
    found: dict[int, dict[str, LineSums]] = field(default_factory=dict)

    def of(self, captures: Sequence[Capture]) -> dict[str, LineSums]:
        """Plane -> sums of two or more captures of one set-up."""
        key = id(captures[0])
        if key not in self.found:
            self.found[key] = self._sums(captures)
        return self.found[key]

    def prepare(self, setups: Sequence[Sequence[Capture]]) -> None:
        """Make the sums of many set-ups, several at a time where frames are large."""
        if not setups or setups[0][0].mosaic.size < THREADED_PIXELS:
            return
        with ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1)) as pool:
            list(pool.map(self.of, setups))

    def _sums(self, captures: Sequence[Capture]) -> dict[str, LineSums]:
        first = captures[0]
        row0, row1, col0, col1 = check_roi(first, self.roi)
        planes = planes_of(first)
        places = {plane: plane_view(first, plane, self.roi)[1] for plane in planes}
        phases = {plane: (row - row0, col - col0) for plane, (row, col) in places.items()}
        found = line_sums(
            [capture.mosaic[row0:row1, col0:col1] for capture in captures],
            step=1 if len(planes) == 1 else 2,
            black_dn={phases[plane]: self.black_dn.get(plane, plane_black_dn(first, plane)) for plane in planes},
            white_dn=first.sensor.white_dn,
        )
        return {plane: found[phases[plane]] for plane in planes}
