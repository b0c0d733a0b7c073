"""``campaign.html``: every group of a folder's pictures with what was found in it, what was refused, and why."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from isetval.app.report.pages import rendered
from isetval.core.sensor import RoiLike
from isetval.core.writing import write_whole
from isetval.files.draft_types import Draft, DraftShot, Seen
from isetval.files.registration import EdgePose

MOST_REFUSED = 40  # regions drawn in one picture: a printed page of text has hundreds


def campaign_html(draft: Draft) -> str:
    """The page as text, one file without script, server or network."""
    return rendered("campaign.html", **page_parts(draft))


def write_campaign_page(draft: Draft, folder: Path | str) -> Path:
    """Write ``campaign.html`` (or that of a folder's second campaign) beside the campaign.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    path = (Path(folder) / draft.file).with_suffix(".html")
    write_whole(path, campaign_html(draft))
    return path


def page_parts(draft: Draft) -> dict[str, Any]:
    """What the page shows."""
    shots = {shot.name: shot for shot in draft.shots}
    sessions = list(dict.fromkeys(one.group.session for one in draft.seen))
    groups = [_card(one, shots) for one in draft.seen]
    counts = [
        (role, sum(c["role"] == role and bool(c["shots"]) for c in groups), sum(c["frames"] for c in groups if c["role"] == role))
        for role in dict.fromkeys(c["role"] for c in groups)
    ]
    return {
        "name": draft.name,
        "maker": draft.maker or "unknown camera",
        "counts": counts,
        "sessions": [(name, [card for card in groups if card["session"] == name]) for name in sessions],
        "unknown": draft.unknown,
        "found": draft.found,
        "priors": draft.priors,
        "skipped": draft.skipped,
        "notes": draft.notes,
    }


def _card(one: Seen, shots: dict[str, DraftShot]) -> dict[str, Any]:
    """One group: its picture with regions drawn in, and its words."""
    from isetval.app.plots.thumbnails import data_url

    fact, words = one.group.first, one.group.words
    own = [shots[name] for name in one.shots]
    facts = [
        f"{fact.exposure.time_s:g} s" if fact.exposure.time_s is not None else "no exposure time",
        *([f"ISO {fact.exposure.iso:g}"] if fact.exposure.iso is not None else []),
        f"mean {100 * one.group.level_dn / fact.span_dn:.2f} % of the range",
        *([f"light {own[0].light} x {own[0].light_level:.4g}"] if own and own[0].light else []),
        *([f"position {words.position}"] if words.position else []),
        *([f"distance {words.distance_m:g} m"] if words.distance_m is not None else []),
        *([f"repeats {own[0].repeat_of}"] if own and own[0].repeat_of else []),
        *([f"turned by {fact.rotation_deg:g} deg"] if fact.rotation_deg else []),
    ]
    return {
        "role": one.content.role,
        "session": one.group.session,
        "shots": list(one.shots),
        "setup": own[0].setup if own else fact.folder,
        "frames": len(one.group.facts),
        "files": list(one.group.files),
        "why": one.content.why,
        "facts": facts,
        "picture": None if one.thumbnail is None else data_url(one.thumbnail),
        "rows": fact.window.rows,
        "cols": fact.window.cols,
        "boxes": [_rectangle(box, name) for name, box in _boxes(one)],
        "edges": [_line(edge, fact.window.rows, fact.window.cols) for edge in one.content.edges],
        "refused": [_rectangle(box, reason) for box, reason in one.content.refused[:MOST_REFUSED]],
        "refused_words": _counted([reason for _, reason in one.content.refused]),
    }


def _boxes(one: Seen) -> list[tuple[str, RoiLike]]:
    chart = one.content.chart
    boxes = [] if chart is None else list(zip(chart.names, chart.boxes, strict=True))
    return boxes + [(f"{edge.orientation}, {edge.angle_deg:.2f} deg", edge.roi) for edge in one.content.edges]


def _rectangle(box: RoiLike, words: str) -> dict[str, Any]:
    row0, row1, col0, col1 = box
    return {"x": col0, "y": row0, "width": col1 - col0, "height": row1 - row0, "words": words}


def _line(edge: EdgePose, rows: int, cols: int) -> dict[str, float]:
    """The fitted edge across its region."""
    slope = math.tan(math.radians(edge.angle_deg))
    row, col = (rows - 1) / 2 + edge.offset_px[0], (cols - 1) / 2 + edge.offset_px[1]
    ends: list[tuple[float, float]]
    if edge.orientation == "vertical":
        ends = [(r, col + slope * (r - (rows - 1) / 2)) for r in edge.roi[:2]]
    else:
        ends = [(row + slope * (c - (cols - 1) / 2), c) for c in edge.roi[2:]]
    return {"x1": ends[0][1], "y1": ends[0][0], "x2": ends[1][1], "y2": ends[1][0]}


def _counted(reasons: Sequence[str]) -> str:
    """``12 x too_short, 3 x angle``."""
    return ", ".join(f"{reasons.count(reason)} x {reason}" for reason in dict.fromkeys(reasons))
