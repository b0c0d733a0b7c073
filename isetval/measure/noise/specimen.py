"""Random numbers of the specimen that several metrics share: one sensor has one pattern of pixels, rows and columns."""

from __future__ import annotations

import math

from isetval.core.campaign import Shot
from isetval.core.capture import Capture, plane_view
from isetval.measure.conditions import window_label
from isetval.measure.noise.statistics import PlaneStatistics, tilt_power


def specimen_loadings(shot: Shot, capture: Capture, plane: str, statistics: PlaneStatistics, key: str) -> dict[str, float]:
    """Labels of the random numbers in a quantity of one plane, and how much of its sigma each makes.

    Pixels belong to their plane and, dark or lit, to another pattern (offsets, gains).  A row's offset is the
    same in both planes that lie on it, in darks and in flats, at every exposure; likewise a column's.  Only the
    lines' variances tie flats to darks: of a flat's mean and rise the light makes more than any line.
    """
    quantity = statistics[key]
    if not quantity.shared > 0:
        return {}
    view, (row, col), _ = plane_view(capture, plane)
    row0, col0, height, width = shot.window or (0, 0, *capture.mosaic.shape)
    name = key.removesuffix("_dn2").removesuffix("_dn")
    kind = name if name.startswith("fixed") else f"{shot.role} {name}"
    lines = {
        f"row:{kind}:{(row0 + row) % 2}:{row0},{height}": _of_lines(key, "row", statistics, view.shape[0]),
        f"column:{kind}:{(col0 + col) % 2}:{col0},{width}": _of_lines(key, "column", statistics, view.shape[1]),
    }
    whole = math.hypot(*lines.values())
    shrink = min(1.0, quantity.shared / whole) if whole > 0 else 1.0
    out = {label: shrink * part for label, part in lines.items() if part > 0}
    own = math.sqrt(max(quantity.shared**2 - (shrink * whole) ** 2, 0.0))
    return out | {f"{shot.role}:{name}:{plane}:{window_label(shot)}": own} if own > 0 else out


def _of_lines(key: str, line: str, statistics: PlaneStatistics, count: int) -> float:
    """Standard deviation that ``count`` fixed rows (or columns) of a plane give to a quantity, over specimens."""
    variance = max(0.0, statistics[f"fixed_{line}_variance_dn2"].value)
    if key == "mean_dn":
        return math.sqrt(variance / count)
    if key == f"gradient_{line}_dn":
        return math.sqrt(variance / tilt_power(count))
    if key == f"fixed_{line}_variance_dn2":
        return variance * math.sqrt(2 / max(count - 3, 1))
    return 0.0
