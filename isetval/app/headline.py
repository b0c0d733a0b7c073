"""The few numbers that people ask for first, out of all metrics of a measurement."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
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


def headline_tables(
    rows: Sequence[Row], *, files: Files | None = None, half_diagonal_mm: float = 0.0, sign: str = "+-"
) -> list[tuple[str, Table]]:
    """Titled tables, each with its header as first row; none where nothing of the kind was measured.

    ``files`` are the described files of a measurement: their shapes say where in the frame an edge lies, and their warnings
    whether the pixel pitch is known.  ``half_diagonal_mm`` is that of a campaign's sensor, which says it of shots (0: unknown).
    """
    field = _Field(files or {}, half_diagonal_mm)
    made = (
        _series(rows, sign),
        _charts(rows, sign),
        _disks(rows, sign),
        _falloff(rows, sign, field),
        _sharpness(rows, sign, field),
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


def _falloff(rows: Sequence[Row], sign: str, field: _Field) -> Iterable[tuple[str, Table]]:
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
        words = "at " + field.words(str(far).rpartition("r ")[2])
        yield f"relative illumination, {place}", [("", *cells), (words, *(_quantity(row, sign) for row in cells.values()))]


def _radius_mm(row: Row) -> float:
    return float(str(row["region"]).rpartition("r ")[2].split()[0])


def _sharpness(rows: Sequence[Row], sign: str, field: _Field) -> Iterable[tuple[str, Table]]:
    """MTF50 of the edges: by place in the field and at the extremes, by channel."""
    own = [row for row in rows if row["name"] == "mtf50" and row["value"] is not None]
    channels = list(dict.fromkeys(row.get("channel", "") for row in own))
    wanted = [c for c in ("G", "MONO") if c in channels] or channels[:1]
    for channel in wanted:
        edges = [row for row in own if row.get("channel", "") == channel]
        table: Table = [("edges", "MTF50", "where")]
        places = [field.place(row) for row in edges]
        several = len({row.get("file", "") for row in edges}) > 1
        radius = [r for r, _ in places]
        told: set[int] = set()
        for words, share in PLACES if max(radius, default=0.0) > min(radius, default=0.0) else ():
            i = min(range(len(edges)), key=lambda i, share=share: abs(radius[i] - share * max(radius)))  # type: ignore[misc]
            if i not in told:  # edges all about the middle have none part way
                table.append((words, _quantity(edges[i], sign), f"{places[i][1]}, {_where(edges[i], several)}"))
            told.add(i)
        if len(edges) > 1:
            for words, pick in (("sharpest", max), ("least sharp", min)):
                row = pick(edges, key=lambda r: float(r["value"]))
                table.append((words, _quantity(row, sign), _where(row, several)))
        else:
            table += [("one edge", _quantity(row, sign), _where(row, several)) for row in edges]
        yield f"sharpness, channel {channel}, {len(edges)} edge{'s' if len(edges) > 1 else ''}", table


def _where(row: Row, several: bool) -> str:
    """The region or shot of an edge, and its file where there are several."""
    place = str(row.get("region") or row.get("shot") or "")
    return f"{PurePath(row['file']).name} {place}" if several and row.get("file") else place


@dataclass(frozen=True)
class _Field:
    """How far from the middle something lies, in words: of half the diagonal where that is known, else on the sensor."""

    files: Files
    half_diagonal_mm: float

    def words(self, place: str) -> str:
        """A distance ``n mm`` on the sensor; in pixels where no file states their pitch (which is then set to 1 um)."""
        codes = [{w.get("code") for w in about.get("warnings", ())} for about in self.files.values()]
        radius_mm = float(place.split()[0])
        if codes and all("no_pixel_pitch" in own for own in codes):
            return f"{1000 * radius_mm:.0f} px"
        share = 100 * radius_mm / self.half_diagonal_mm if self.half_diagonal_mm else 0.0
        return f"{place}, {share:.0f} % of the half diagonal" if share else place

    def place(self, row: Row) -> tuple[float, str]:
        """Distance of an edge and how to say it: of the file's frame where that is known."""
        shape = self.files.get(str(row.get("file", "")), {}).get("shape")
        corners = str(row.get("region", "")).split(",")
        radius_mm = math.hypot(row.get("field_x_mm") or 0.0, row.get("field_y_mm") or 0.0)
        share = radius_mm / self.half_diagonal_mm if self.half_diagonal_mm else None
        if shape and len(corners) == 4 and all(c.isdigit() for c in corners):
            row0, row1, col0, col1 = map(int, corners)
            share = math.hypot(row0 + row1 - shape[0], col0 + col1 - shape[1]) / math.hypot(*shape)
        return (radius_mm, f"{radius_mm:.2f} mm") if share is None else (share, f"{100 * share:.0f} % of the half diagonal")
