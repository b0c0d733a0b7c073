"""What a campaign would measure, without measuring it: files that can be read, targets inside their windows, clipped levels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from isetval.camera.model_file import load_model
from isetval.camera.shooting import needs_light
from isetval.core.campaign import Campaign, Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.scene import EdgeTarget
from isetval.effects.color import QuantumEfficiency
from isetval.files.campaign_file import camera_file
from isetval.files.file_facts import WHITE_SHARE, facts_of
from isetval.files.target_search import edges_in
from isetval.measure.campaign import analyses

Progress = Callable[[str, int, int], None]
TILT_DEG = 1.5  # of an edge, beyond what a chart is set up to (some tenths), and far below a tilt of the other sign
ONE_CODE_SHARE = 0.1  # of pixels at the highest code: with any noise it holds a thousandth; a color that is full a quarter
DARK_SHARE = 0.001  # of the range: a lit shot below has nothing to measure


@dataclass(frozen=True)
class CheckedShot:
    """One shot: how many of its frames can be read, which analyses would run, and what is doubtful."""

    shot: str
    role: str
    session: str
    setup: str
    frames: int
    readable: int
    analyses: tuple[str, ...]
    doubts: tuple[str, ...]


def check_campaign(campaign: Campaign, *, progress: Progress | None = None) -> list[CheckedShot]:
    """Open every shot of a campaign and say what would be measured.

    Files that cannot be read are then in ``campaign.captures.skipped``.
    """
    out = []
    for i, shot in enumerate(campaign.shots):
        frames = campaign.captures.read(shot.name)
        names = tuple(module.__name__.rsplit(".", 1)[-1] for module in analyses(shot.role)) if frames else ()
        doubts = tuple(_doubts(shot, frames[0])) if frames else ("no frame can be read",)
        out.append(
            CheckedShot(shot.name, shot.role, shot.measurement_session, shot.setup, len(shot.files), len(frames), names, doubts)
        )
        if progress is not None:
            progress(f"checking {shot.name}", i + 1, len(campaign.shots))
    return out


def doubts_of_all(campaign: Campaign) -> list[str]:
    """What is doubtful of the whole: the camera that it names and its tables, names of sessions."""
    out = []
    try:
        path = camera_file(campaign.camera, campaign.folder or Path())
        if path is not None:
            efficiency = load_model(path).effect("quantum_efficiency")
            if isinstance(efficiency, QuantumEfficiency) and efficiency.file:
                efficiency.table()  # which the model reads where it is used
    except InputError as error:
        out = [str(error)]
    sizes = Counter(shot.measurement_session for shot in campaign.shots)
    for name, count in sizes.items():
        alike = (other for other in sizes if other != name and other.strip().casefold() == name.strip().casefold())
        if (other := next(alike, None)) is not None and count < sizes[other]:
            out.append(f"measurement_session {name!r} ({count} shots) is {other!r} ({sizes[other]}) written otherwise")
    return out


def _doubts(shot: Shot, capture: Capture) -> list[str]:
    """What would be refused or weak, by the first frame."""
    fact = facts_of(shot.name, "", capture)
    out = []
    if shot.window is not None and tuple(shot.window[2:]) != capture.mosaic.shape:
        out.append(
            f"the window has {shot.window[2]} x {shot.window[3]} pixels, its files {fact.window.rows} x {fact.window.cols}"
        )
    if fact.clipped > WHITE_SHARE:
        out.append(f"{100 * fact.clipped:.1f} % of the pixels stand at white")
    out += _top_doubts(shot, capture, fact.span_dn)
    if shot.role != "dark" and fact.level_dn < DARK_SHARE * fact.span_dn:
        out.append("it is as dark as a dark")
    if shot.exposure.time_s is None:
        out.append("no exposure time: it cannot be compared with a model")
    if needs_light(shot):
        out.append("no light: it cannot be compared with a model")
    rows, cols = capture.mosaic.shape
    regions = [patch.box for patch in getattr(shot.target, "patches", ())]
    regions += [roi] if (roi := getattr(shot.target, "roi", None)) is not None else []
    outside = sum(not (0 <= r0 < r1 <= rows and 0 <= c0 < c1 <= cols) for r0, r1, c0, c1 in regions)
    if outside:
        out.append(f"{outside} of {len(regions)} regions lie outside the window of {rows} x {cols} pixels")
    return out + _edge_doubts(shot, capture)


def _top_doubts(shot: Shot, capture: Capture, span_dn: float) -> list[str]:
    """That bright pixels stand at one code below the white level: where a model saturates at that level no row is compared."""
    top, white = int(capture.mosaic.max()), capture.sensor.white_dn
    at_top = float(np.mean(capture.mosaic == top))
    if shot.role == "dark" or at_top < ONE_CODE_SHARE or not white - span_dn / 2 < top < white:
        return []
    return [
        f"{100 * at_top:.0f} % of the pixels stand at code {top}, below the file's white level {white:g}: which of them is right?"
    ]


def _edge_doubts(shot: Shot, capture: Capture) -> list[str]:
    """That the edge in the file is tilted otherwise than stated: a simulated one would be its mirror image."""
    stated = shot.target
    if not isinstance(stated, EdgeTarget):
        return []
    try:
        found = [edge for edge in edges_in(capture, shot.channel).targets if isinstance(edge, EdgeTarget)]
    except InputError as error:
        return [str(error)]
    if not found:
        return []
    alike = [edge for edge in found if edge.orientation == stated.orientation]
    if not alike:
        return [f"its edge is {found[0].orientation}, orientation says {stated.orientation}"]
    nearest = min(alike, key=lambda edge: abs(edge.angle_deg - stated.angle_deg))
    if abs(nearest.angle_deg - stated.angle_deg) > TILT_DEG:
        return [f"its edge is tilted by {nearest.angle_deg:.1f} degrees, angle_deg says {stated.angle_deg:g}"]
    return []
