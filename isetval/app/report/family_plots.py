"""Any family of metrics as a plot: measured with its band, simulated by each model, over the condition that varies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from isetval.app.report import svg
from isetval.app.report.charts import PLANE_CLASS, axis_of, level_number, row_words, thinned

Row = Mapping[str, Any]
Key = tuple[Any, ...]
MOST_CURVES = 6  # in one plot: more of them hide each other
BAND_SIGMAS = 2.0
LOG_SPAN = 20.0  # ratio of the largest to the smallest value from which an axis is logarithmic


@dataclass(frozen=True)
class FamilyPlot:
    """The picture and what of the family it leaves out; empty where nothing can be drawn."""

    svg: str
    hint: str = ""


def family_plot(family: str, by_model: Sequence[Sequence[Row]]) -> FamilyPlot:
    """Measured points with a band of two sigma and, in a layer for each model, what it predicts.

    Drawn over frequency, patch, exposure, field radius or shot, whichever varies; of many curves the worst of the first model.
    """
    parts = [[r for r in rows if r["family"] == family and None not in (r["measured"], r["simulated"])] for rows in by_model]
    if not parts or not parts[0]:
        return FamilyPlot("")
    label, kind, value = axis_of(parts[0])
    names = list(dict.fromkeys(str(value(r)) for r in parts[0])) if kind == "names" else []
    place = (lambda r: float(names.index(str(value(r))))) if names else value
    curves = [_curves(part, place, kind) for part in parts]
    worst = sorted(curves[0], key=lambda key: -_misfit(curves[0][key]))[:MOST_CURVES]
    shown = [{key: own[key] for key in worst if key in own} for own in curves]
    if not any(shown[0].values()):
        return FamilyPlot("")
    area = _area(shown, place, kind)
    unit = parts[0][0]["unit"]
    body = area.axes(label, family.replace("_", " ") + (f", {unit}" if unit not in ("1", "") else ""), x_names=thinned(names))
    body += "".join(_measured(area, key, rows, place, names) for key, rows in shown[0].items())
    for i, own in enumerate(shown):
        layer = "".join(_simulated(area, key, rows, place, names) for key, rows in own.items())
        body += f'<g class="layer" data-model="{i}">{layer}</g>'
    left_out = len(curves[0]) - len(worst)
    hint = f"the {len(worst)} curves that fit worst, of {len(curves[0])}" if left_out else ""
    return FamilyPlot(area.svg(body, f"{family} measured and simulated over {label}"), hint)


def _curves(rows: Sequence[Row], place: Callable[[Row], Any], kind: str) -> dict[Key, list[Row]]:
    """Rows that belong to one line, in order of their place."""
    by_shot = kind == "names" or len({r.get("frequency_cy_px") for r in rows}) > 1 or place is level_number
    lines: dict[Key, list[Row]] = {}
    for row in rows:
        at = place(row)
        if at is not None and (kind != "log" or at > 0):
            key = (row["channel"], row["name"], row["shot"] if by_shot and row.get("shot") else "")
            lines.setdefault(key if kind != "names" else key[:2], []).append(row)
    out = {own: part for key, members in lines.items() for own, part in _by_region(key, members, place).items()}
    return {key: sorted(own, key=lambda r: float(place(r))) for key, own in out.items()}


def _by_region(key: Key, rows: Sequence[Row], place: Callable[[Row], Any]) -> dict[Key, list[Row]]:
    """One line for each region, unless the regions are the places along it (rings of a fall-off)."""
    if len({place(row) for row in rows}) == len(rows):
        return {key: list(rows)}
    out: dict[Key, list[Row]] = {}
    for row in rows:
        out.setdefault((*key, row.get("region")), []).append(row)
    return out


def _misfit(rows: Sequence[Row]) -> float:
    return sum((r["z"] or 0.0) ** 2 for r in rows) / len(rows)


def _ends(row: Row) -> tuple[float, float]:
    half = BAND_SIGMAS * (row["sigma"] or 0.0)
    return row["measured"] - half, row["measured"] + half


def _area(shown: Sequence[Mapping[Key, Sequence[Row]]], place: Callable[[Row], Any], kind: str) -> svg.Frame:
    rows = [row for own in shown for curve in own.values() for row in curve]
    xs = [float(place(r)) for r in rows]
    centers = [v for r in rows for v in (r["measured"], r["simulated"])]
    log_y = min(centers) > 0 and max(centers) > LOG_SPAN * min(centers)
    ys = centers if log_y else [*centers, *(v for r in rows for v in _ends(r))]
    return svg.frame((min(xs), max(xs)), (min(ys), max(ys)), log_x=kind == "log" and min(xs) < max(xs), log_y=log_y)


def _measured(area: svg.Frame, key: Key, rows: Sequence[Row], place: Callable[[Row], Any], names: Sequence[str]) -> str:
    colour = PLANE_CLASS.get(key[0], "grey")
    xs = [area.x(float(place(r))) for r in rows]
    low, high = ([area.y(_ends(r)[end]) for r in rows] for end in (0, 1))
    points = svg.dots([(x, area.y(r["measured"])) for x, r in zip(xs, rows, strict=True)], colour)
    if names or len(set(xs)) < 3:
        return "".join(svg.line(x, a, x, b, f"bar {colour}") for x, a, b in zip(xs, low, high, strict=True)) + points
    return svg.area([*zip(xs, low, strict=True), *zip(xs[::-1], high[::-1], strict=True)], f"sigma {colour}") + points


def _simulated(area: svg.Frame, key: Key, rows: Sequence[Row], place: Callable[[Row], Any], names: Sequence[str]) -> str:
    colour = PLANE_CLASS.get(key[0], "grey")
    spots = [(area.x(float(place(r))), area.y(r["simulated"])) for r in rows]
    if not names and len({x for x, _ in spots}) > 1:
        return svg.polyline(spots, f"curve {colour}")
    return "".join(svg.circle(*spot, f"far {colour}", row_words(r)) for spot, r in zip(spots, rows, strict=True))
