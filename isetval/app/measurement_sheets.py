"""Which sheets a measurement has: the frames of single files, the series of darks and flats of a session."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from isetval.core.campaign import Campaign, Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.files.captures import defect_words
from isetval.measure.summaries import Chain

if TYPE_CHECKING:
    from isetval.app.plots.sheets import Sheet

Note = Callable[[str], None]
MOST_FRAMES = 12  # files or shots drawn one by one: a page that a person reads
LEAST_LEVELS = 3  # of a photon-transfer curve
LEAST_PLACES = 6  # windows over the field, below which there is no fall-off to draw


def sheets_of_campaign(campaign: Campaign, note: Note) -> list[Sheet]:
    """Series of every session, then edges, charts and scenes shot by shot; what cannot be drawn is said to ``note``."""
    sheets: list[Sheet] = []
    for session in campaign.sessions:
        label = f"session {session}" if len(campaign.sessions) > 1 else campaign.name
        for make in (_transfer, _dark, _illumination):
            sheets += _tried(lambda make=make, session=session, label=label: make(campaign, session, label), note)  # type: ignore[misc]
    single = [shot for shot in campaign.shots if shot.role in ("edge", "chart", "scene")]
    for shot in single[:MOST_FRAMES]:
        sheets += _tried(lambda shot=shot: _shot_sheets(campaign, shot), note)  # type: ignore[misc]
    if len(single) > MOST_FRAMES:
        note(f"{len(single) - MOST_FRAMES} further shots are in the table, without a picture")
    return sheets


def sheets_of_files(
    paths: Sequence[Path], read: Callable[[Path], Capture], *, role: str | None, channel: str, note: Note
) -> list[Sheet]:
    """Frames of loose files: the chart, or the edges, that each shows."""
    sheets: list[Sheet] = []
    for path in paths[:MOST_FRAMES]:
        sheets += _tried(lambda path=path: frame_sheets(read(path), path.name, role=role, channel=channel), note)  # type: ignore[misc]
    if len(paths) > MOST_FRAMES:
        note(f"{len(paths) - MOST_FRAMES} further files are in the table, without a picture")
    return sheets


def frame_sheets(capture: Capture, name: str, *, role: str | None = None, channel: str = "") -> list[Sheet]:
    """The chart of a frame where there is one, else its edges; of printed disks the disks."""
    from isetval.app.plots.disk_sheet import disk_sheet
    from isetval.app.plots.sheets import chart_sheet, edge_sheets

    if role == "disk":
        return [disk_sheet(capture, name)]
    if role in (None, "chart"):
        try:
            return [chart_sheet(capture, name)]
        except InputError:
            if role == "chart":
                raise
    return edge_sheets(capture, name, channel=channel or "G")


def _tried(make: Callable[[], list[Sheet]], note: Note) -> list[Sheet]:
    try:
        return make()
    except InputError as error:
        note(f"no picture: {error}")
    except Exception as error:  # a picture must not lose the numbers
        note(f"no picture: {defect_words(error)}")
    return []


def _frames(campaign: Campaign, session: str, role: str) -> Iterator[tuple[Shot, Sequence[Capture]]]:
    for shot in campaign.shots:
        if shot.role == role and shot.measurement_session == session:
            frames = campaign.captures.read(shot.name)
            if frames:
                yield shot, frames


def _captures(shots: Sequence[tuple[Shot, Sequence[Capture]]]) -> Sequence[Capture]:
    """All frames as one series; long ones are decoded as they are looked at."""
    return Chain([frames for _, frames in shots])


def _most_used_window(campaign: Campaign, session: str, role: str) -> list[tuple[Shot, Sequence[Capture]]]:
    """Shots of the window that most of a role have, with their frames."""
    found = list(_frames(campaign, session, role))
    if not found:
        return []
    window = Counter(shot.window for shot, _ in found).most_common(1)[0][0]
    return [(shot, frames) for shot, frames in found if shot.window == window]


def _transfer(campaign: Campaign, session: str, label: str) -> list[Sheet]:
    from isetval.app.plots.sheets import transfer_sheet

    shots = _most_used_window(campaign, session, "flat")
    flats = _captures(shots)
    if len(flats) < LEAST_LEVELS:
        return []
    photons = [shot.photons_per_pixel for shot, frames in shots for _ in range(len(frames))]
    method = next((shot.method for shot, _ in shots if shot.method), "default")
    darks = _captures(_most_used_window(campaign, session, "dark"))
    return [transfer_sheet(flats, darks, label, method=method, photons=None if None in photons else photons)]


def _dark(campaign: Campaign, session: str, label: str) -> list[Sheet]:
    from isetval.app.plots.sheets import dark_sheet

    darks = _captures(_most_used_window(campaign, session, "dark"))
    return [dark_sheet(darks, label)] if darks else []


def _illumination(campaign: Campaign, session: str, label: str) -> list[Sheet]:
    from isetval.app.plots.sheets import illumination_sheet

    found = list(_frames(campaign, session, "flat"))
    sheets: list[Sheet] = []
    for setup in dict.fromkeys(shot.setup for shot, _ in found):
        own = [(shot, frames) for shot, frames in found if shot.setup == setup]
        whole = [(shot, frames) for shot, frames in own if _is_whole(frames[0])]
        places = {shot.window for shot, _ in own}
        if whole or len(places) >= LEAST_PLACES:
            sheets.append(illumination_sheet(_captures(whole or own), (), f"{label}, {setup}"))
    return sheets


def _is_whole(capture: Capture) -> bool:
    return capture.mosaic.shape == (capture.sensor.rows, capture.sensor.cols)


def _shot_sheets(campaign: Campaign, shot: Shot) -> list[Sheet]:
    """A shot's first frame: the edge that its target states, or what is found in it."""
    from isetval.app.plots.sheets import edge_sheets, sfr_sheet
    from isetval.measure import sfr

    frames = campaign.captures.read(shot.name)
    if not frames:
        return []
    if shot.role == "edge":
        result = sfr(frames[0], getattr(shot.target, "roi", None), shot.channel or "G", method=shot.method or "default")
        return [sfr_sheet(frames[0], [result], shot.name)] if result.accepted else edge_sheets(frames[0], shot.name)
    return frame_sheets(frames[0], shot.name, role="chart" if shot.role == "chart" else None)
