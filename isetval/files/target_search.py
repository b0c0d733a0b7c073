"""What a picture shows, found in itself: the boxes of a chart, the regions of slanted edges, even parts of a scene.

Only places are found here; what stands in them is measured by the analyses of campaigns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture
from isetval.core.errors import InputError, MeasurementError
from isetval.core.scene import ChartTarget, EdgeTarget, Patch, Spectrum
from isetval.core.sensor import RoiLike

Float = NDArray[np.float64]
LEAST_BOX_PX = 4
MOST_REASONS = 20
UNKNOWN = Spectrum.flat(0.0)  # the reflectance of what was only found


@dataclass(frozen=True, eq=False)
class Found:
    """Targets found in a capture and remarks on them: what was accepted, what was not and why."""

    targets: tuple[EdgeTarget | ChartTarget, ...]
    notes: tuple[str, ...]


def find_targets(capture: Capture, role: str | None, *, roi: RoiLike | None = None, channel: str = "") -> Found:
    """Targets of a role in a capture; without a role a chart, else slanted edges.

    Parameters
    ----------
    capture : Capture
    role : {"edge", "chart", "disk", "scene"} or None
    roi : (row0, row1, col0, col1), optional
        Where the edge or disk is: nothing is searched then.
    channel : str
        Channel that edges are tried in; default green.
    """
    looks = {
        "edge": (edges_in,),
        "chart": (chart_in,),
        "disk": (disks_in,),
        "scene": (even_parts_in,),
        None: (chart_in, edges_in),
    }[role]
    if role == "disk" and roi is not None:
        return Found((ChartTarget("disks", disks=(roi,)),), ())
    if role == "edge" and roi is not None:
        return Found((EdgeTarget("edge", roi=roi),), ())
    notes: list[str] = []
    for look in looks:
        try:
            found = look(capture, channel)
        except InputError as error:
            notes.append(str(error))
            continue
        notes += found.notes
        if found.targets:
            return Found(found.targets, tuple(notes))
    return Found((), tuple(notes))


def chart_in(capture: Capture, channel: str = "") -> Found:
    """The 24-patch chart, as boxes of the inner half of each patch.

    Raises
    ------
    MeasurementError
        Where there is none, or it stands so oblique that no upright box fits into a patch.
    """
    from isetval.measure import chart

    result = chart(capture)
    patches = tuple(Patch(name, upright_box(quad), UNKNOWN) for name, quad in zip(result.names, result.corners_px, strict=True))
    clipped, bad = int(result.patches.clipped_pixels.sum()), int(result.patches.bad_pixels.sum())
    words = f"chart found ({result.found_by}), its colours agree {result.confidence:.2f}"
    words += f"; in the patches {clipped} clipped and {bad} bad pixels were left out" if bad else f"; {clipped} clipped pixels"
    return Found((ChartTarget("chart", patches, margin_px=0),), (words, *result.warnings))


def upright_box(quad: Float) -> RoiLike:
    """The upright box inside a quadrilateral (4, 2) of (row, col).

    Raises
    ------
    MeasurementError
        When it is smaller than 4 pixels.
    """
    rows, cols = np.sort(quad[:, 0]), np.sort(quad[:, 1])
    box = (int(np.ceil(rows[1])), int(np.floor(rows[2])) + 1, int(np.ceil(cols[1])), int(np.floor(cols[2])) + 1)
    if box[1] - box[0] < LEAST_BOX_PX or box[3] - box[2] < LEAST_BOX_PX:
        raise MeasurementError(
            f"the patch at row {quad[:, 0].mean():.0f}, column {quad[:, 1].mean():.0f} leaves a box of "
            f"{box[1] - box[0]} x {box[3] - box[2]} pixels; it needs {LEAST_BOX_PX} each way: turn the chart upright"
        )
    return box


def edges_in(capture: Capture, channel: str = "") -> Found:
    """Every slanted edge, with its region, angle and dark side."""
    from isetval.measure import find_edges

    found = find_edges(capture, channel or "G")
    targets = []
    for edge in found:
        across_rows = 45 <= edge.normal_deg % 180 < 135
        targets.append(
            EdgeTarget(
                "edge " + ",".join(map(str, edge)),
                angle_deg=-edge.angle_deg if not across_rows else edge.angle_deg,
                orientation="horizontal" if across_rows else "vertical",
                dark_side="low" if _towards_higher(edge.normal_deg) else "high",
                roi=(edge[0], edge[1], edge[2], edge[3]),
            )
        )
    notes = [f"{len(found)} edges accepted, {len(found.rejected)} rejected"]
    notes += [f"edge rejected at {','.join(map(str, r.roi))}: {r.reason}" for r in found.rejected[:MOST_REASONS]]
    return Found(tuple(targets), tuple(notes))


def disks_in(capture: Capture, channel: str = "") -> Found:
    """Printed disks, each with a box around it."""
    from isetval.measure.edge.disk_edges import find_disks

    boxes = tuple(find_disks(capture))
    targets = (ChartTarget("disks", disks=boxes),) if boxes else ()
    return Found(targets, (f"{len(boxes)} round blobs that lie wholly in the picture",))


def _towards_higher(normal_deg: float) -> bool:
    """Whether the bright side lies at higher columns (rows, for horizontal edges)."""
    return (normal_deg + 45) % 360 < 180


def even_parts_in(capture: Capture, channel: str = "") -> Found:
    """Even parts of a scene, spread over its levels."""
    from isetval.measure.uniform_regions import uniform_regions

    regions = uniform_regions(capture)
    patches = tuple(Patch(",".join(map(str, region)), region, UNKNOWN) for region in regions)
    targets = (ChartTarget("even parts", patches, margin_px=0),) if patches else ()
    return Found(targets, (f"{len(regions)} even regions, spread over the levels",))
