"""The few numbers that people ask for first, out of all metrics of a measurement."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from isetval.app.words import with_sigma

Row = Mapping[str, Any]
Files = Mapping[str, Mapping[str, Any]]
Table = list[tuple[str, ...]]
PLACES = (("nearest the center", 0.0), ("part way", 0.7), ("farthest out", 1.0))
"""Shares of the distance of the outermost edge."""
SERIES = {
    "gain_dn_per_e": "conversion gain",
    "read_noise_e": "read noise",
    "read_noise_dn": "read noise",
    "quantum_efficiency": "quantum efficiency",
    "prnu": "PRNU",
    "dsnu_e": "DSNU",
    "dsnu_dn": "DSNU",
    "dark_current_e_per_s": "dark current",
    "dark_current_dn_per_s": "dark current",
    "full_well_e": "full well",
    "snr_max_db": "SNR max",
    "dynamic_range_db": "dynamic range",
    "black_level_dn": "black level",
}
"""Summaries of a session by their metric name, in the order in which they are asked for."""
COLOR_ERRORS = {"de2000_gains_only": "with one gain a channel", "de2000_fitted": "with a fitted 3 x 3 matrix"}
"""Of a chart's mean colour error, by what the camera's colours are corrected with."""
ONE_OF = (("read_noise_e", "read_noise_dn"), ("dsnu_e", "dsnu_dn"), ("dark_current_e_per_s", "dark_current_dn_per_s"))
"""Where the first is known the second says the same in other units."""


def headline_tables(rows: Sequence[Row], *, files: Files | None = None, sign: str = "+-") -> list[tuple[str, Table]]:
    """Titled tables, each with its header as first row; none where nothing of the kind was measured.

    ``files`` are the described files of a measurement: their shapes say where in the frame an edge lies.
    """
    made = (
        _series(rows, sign),
        _charts(rows, sign),
        _disks(rows, sign),
        _falloff(rows, sign),
        _sharpness(rows, sign, files or {}),
    )
    found = [entry for part in made for entry in part]
    return [(title, table) for title, table in found if len(table) > 1]


def _quantity(row: Row, sign: str) -> str:
    bound = "at least " if "no_saturated_level" in str(row.get("reason", "")) else ""
    return bound + with_sigma(row["value"], row["sigma"], row["unit"], sign=sign)


def _series(rows: Sequence[Row], sign: str) -> Iterable[tuple[str, Table]]:
    own = [row for row in rows if row["name"] in SERIES and str(row.get("family", "")).startswith("summary_")]
    for session in dict.fromkeys(row.get("measurement_session", "") for row in own):
        cells = {(r["name"], r.get("channel", "")): r for r in own if r.get("measurement_session", "") == session}
        cells |= _in_electrons(cells)
        planes = list(dict.fromkeys(plane for _, plane in cells))
        known = {name for name, _ in cells}
        twice = {second for first, second in ONE_OF if first in known}
        table: Table = [("", *planes)]
        for name, words in SERIES.items():
            if name in known - twice:
                table.append((words, *(_quantity(cells[name, p], sign) if (name, p) in cells else "" for p in planes)))
        yield f"sensor{_of(session)}", table


def _in_electrons(cells: Mapping[tuple[str, str], Row]) -> dict[tuple[str, str], Row]:
    """The dark current in e-/s of the planes whose conversion gain is known."""
    out: dict[tuple[str, str], Row] = {}
    for (name, plane), row in cells.items():
        gain = cells.get(("gain_dn_per_e", plane))
        if name == "dark_current_dn_per_s" and gain and gain["value"]:
            value = row["value"] / gain["value"]
            sigma = math.hypot(row["sigma"], value * gain["sigma"]) / gain["value"]
            out["dark_current_e_per_s", plane] = {"value": value, "sigma": sigma, "unit": "e-/s"}
    return out


def _charts(rows: Sequence[Row], sign: str) -> Iterable[tuple[str, Table]]:
    """Colour error of every chart of 24 published patches: mean over its patches."""
    own: dict[str, dict[str, Row]] = {}
    for row in rows:
        if row["name"] in COLOR_ERRORS:
            own.setdefault(str(row.get("shot") or row.get("file", "")), {})[row["name"]] = row
    table: Table = [("dE2000", *COLOR_ERRORS.values())]
    table += [(place, *(_quantity(here[name], sign) for name in COLOR_ERRORS if name in here)) for place, here in own.items()]
    yield "chart, mean colour error of the patches", table


def _disks(rows: Sequence[Row], sign: str) -> Iterable[tuple[str, Table]]:
    """Printed disks: how many, the sharpest and the least sharp edges of each colour, the largest lateral colour."""
    count = [row for row in rows if row["name"] == "disk_radius"]
    mtf50 = [row for row in rows if row["name"] == "disk_mtf50"]
    channels = list(dict.fromkeys(str(row.get("channel", "")) for row in count))
    table: Table = [("printed disks", "accepted", "MTF50, sharpest", "MTF50, least sharp")]
    for channel in channels:
        own = [row for row in mtf50 if row.get("channel", "") == channel]
        ends = [_quantity(pick(own, key=lambda r: float(r["value"])), sign) for pick in (max, min)] if own else ["", ""]
        table.append((channel, str(sum(row.get("channel", "") == channel for row in count)), *ends))
    yield "printed disks", table
    lateral = [row for row in rows if row["name"] == "lateral_color_radial"]
    colors: Table = [("lateral colour", "largest, away from the middle", "where")]
    for channel in dict.fromkeys(str(row.get("channel", "")) for row in lateral):
        row = max((r for r in lateral if r.get("channel", "") == channel), key=lambda r: abs(float(r["value"])))
        colors.append((channel, _quantity(row, sign), str(row.get("shot") or row.get("file", ""))))
    yield "lateral colour of the disks", colors


def _of(session: str) -> str:
    return f", session {session}" if session else ""


def _falloff(rows: Sequence[Row], sign: str) -> Iterable[tuple[str, Table]]:
    """Relative illumination farthest out: of every set-up of windows, and of the full frame that tells it best in its session."""
    own = [row for row in rows if row["name"] == "relative_illumination"]
    places: dict[str, list[Row]] = {}
    for row in own:
        place = str(row.get("region", "")).rpartition(", r ")[0] or str(row.get("shot", ""))
        places.setdefault(place, []).append(row)
    whole: dict[str, list[str]] = {}
    for place, here in places.items():
        if ", r " not in str(here[0].get("region", "")):
            whole.setdefault(str(here[0].get("measurement_session", "")), []).append(place)
    best = {
        min(shots, key=lambda shot: sum(float(r["sigma"]) for r in places[shot]) / len(places[shot])) for shots in whole.values()
    }
    others = {shot for shots in whole.values() for shot in shots} - best
    for place, here in places.items():
        if place in others:
            continue
        far = max(here, key=lambda row: _radius_mm(row))["region"]
        cells = {row.get("channel", ""): row for row in here if row["region"] == far}
        yield f"relative illumination, {place}", [("", *cells), (_at(far), *(_quantity(row, sign) for row in cells.values()))]


def _radius_mm(row: Row) -> float:
    return float(_at(str(row["region"])).split()[1])


def _at(region: str) -> str:
    return "at " + region.rpartition("r ")[2]


def _sharpness(rows: Sequence[Row], sign: str, files: Files) -> Iterable[tuple[str, Table]]:
    """MTF50 of the edges: by place in the field and at the extremes, by channel."""
    own = [row for row in rows if row["name"] == "mtf50" and row["value"] is not None]
    channels = list(dict.fromkeys(row.get("channel", "") for row in own))
    wanted = [c for c in ("G", "MONO") if c in channels] or channels[:1]
    for channel in wanted:
        edges = [row for row in own if row.get("channel", "") == channel]
        table: Table = [("edges", "MTF50", "where")]
        places = [_place(row, files) for row in edges]
        radius = [r for r, _ in places]
        if max(radius, default=0.0) > min(radius, default=0.0):
            for words, share in PLACES:
                i = min(range(len(edges)), key=lambda i, share=share: abs(radius[i] - share * max(radius)))  # type: ignore[misc]
                table.append((words, _quantity(edges[i], sign), f"{places[i][1]}, {_where(edges[i])}"))
        if len(edges) > 1:
            for words, pick in (("sharpest", max), ("least sharp", min)):
                row = pick(edges, key=lambda r: float(r["value"]))
                table.append((words, _quantity(row, sign), _where(row)))
        else:
            table += [("one edge", _quantity(row, sign), _where(row)) for row in edges]
        yield f"sharpness, channel {channel}, {len(edges)} edge{'s' if len(edges) > 1 else ''}", table


def _place(row: Row, files: Files) -> tuple[float, str]:
    """Distance from the middle of the field and how to say it: of the file's frame where that is known, else on the sensor."""
    shape = files.get(str(row.get("file", "")), {}).get("shape")
    corners = str(row.get("region", "")).split(",")
    if shape and len(corners) == 4 and all(c.isdigit() for c in corners):
        row0, row1, col0, col1 = map(int, corners)
        share = math.hypot(row0 + row1 - shape[0], col0 + col1 - shape[1]) / math.hypot(*shape)
        return share, f"{100 * share:.0f} % of the half diagonal"
    radius_mm = math.hypot(row.get("field_x_mm") or 0.0, row.get("field_y_mm") or 0.0)
    return radius_mm, f"{radius_mm:.2f} mm"


def _where(row: Row) -> str:
    return str(row.get("region") or row.get("shot") or "")
