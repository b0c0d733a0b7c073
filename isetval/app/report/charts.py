"""The plots of the report, drawn from the rows of a comparison and of a ladder."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from isetval.app.report import svg
from isetval.app.words import state_of

Row = Mapping[str, Any]
PLANE_CLASS = {"R": "red", "Gr": "green", "Gb": "teal", "G": "green", "B": "blue"}
FAR_Z = 4.0
LETTER_PX = 6.0  # width of a letter of 11 px in the fonts of browsers, generously


def ladder_bars(families: Sequence[str], columns: Sequence[Mapping[str, Row]], *, limit: int = 9, narrow: bool = False) -> str:
    """Mean-square z of the worst families on a logarithmic axis: a hollow mark before, a filled one after.

    ``narrow`` is for telephones: names above the lines and not beside them, so that letters keep their size.
    """
    worst = sorted(families, key=lambda f: -max(c[f]["mean_square_z"] or 0 for c in columns if f in c))[:limit]
    values = [c[f]["mean_square_z"] for c in columns for f in worst if f in c and c[f]["mean_square_z"]]
    if not values:
        return ""
    step, width = (34, 270) if narrow else (19, 470)
    height = 30 + step * len(worst)
    left = 8 if narrow else max(168, LETTER_PX * max(map(len, worst)) + 14)
    x = svg.Scale(min(0.5, *values), max(3.0, *values) * 1.15, left, width - 18, log=True)
    parts = [svg.rect(x(0.85), 6, x(1.15) - x(0.85), height - 30, "band"), svg.line(x(1), 6, x(1), height - 24, "one")]
    parts += [
        svg.line(x(v), height - 24, x(v), height - 20, "tick") + svg.text(x(v), height - 9, svg.tick_words(v)) for v in x.ticks()
    ]
    for i, family in enumerate(worst):
        y = (30 if narrow else 16) + step * i
        cells = [c[family] for c in columns if family in c]
        places = [x(cell["mean_square_z"]) for cell in cells]
        name = family.replace("_", " ")
        parts.append(svg.text(left, y - 12, name, anchor="start") if narrow else svg.text(left - 8, y + 4, name, anchor="end"))
        parts.append(svg.line(places[0], y, places[-1], y, "fall"))
        for j, (cell, at) in enumerate(zip(cells, places, strict=True)):
            kind = "before" if j < len(cells) - 1 else f"after {state_of(cell['mean_square_z'], cell['n'])}"
            words = f"{cell['model']}: {family} mean-square z {cell['mean_square_z']:.3f} (n {cell['n']})"
            parts.append(svg.circle(at, y, kind, words))
    return svg.Frame(x, x, width, height).svg("".join(parts), "Mean-square z of each family before and after")


def axis_of(rows: Sequence[Row]) -> tuple[str, str, Callable[[Row], Any]]:
    """The condition that a family is best drawn over: label, kind (linear, log, names), and its value."""

    def distinct(key: Callable[[Row], Any]) -> int:
        return len({v for row in rows if (v := key(row)) is not None})

    if distinct(lambda r: r.get("frequency_cy_px")) > 2:
        return "frequency, cy/px", "linear", lambda r: r.get("frequency_cy_px")
    if distinct(lambda r: r.get("patch") or None) > 2:
        return "patch", "names", lambda r: r.get("patch")
    if distinct(level_number) > 2:
        return "level of brightness, dark to bright", "linear", level_number
    in_the_dark = all(r.get("role") == "dark" for r in rows)
    if distinct(_light) > (1 if in_the_dark else 3) and distinct(_light) >= distinct(_radius) - 2:
        name = "exposure time, s" if in_the_dark else "light level x exposure time, s"
        return name, "log", _light
    if distinct(_radius) > 1:
        return "field radius, mm", "linear", _radius
    return "shot", "names", lambda r: r.get("shot")


def level_number(row: Row) -> int | None:
    """The number of a region ``level n`` (patches of a chart in order of their brightness)."""
    kind, _, number = str(row.get("region") or "").partition(" ")
    return int(number) if kind == "level" and number.isdigit() else None


def _light(row: Row) -> float | None:
    time_s, level = row.get("exposure_s"), row.get("level")
    if not time_s:
        return None
    value = float(time_s) * (1.0 if row.get("role") == "dark" else float(level if level is not None else 1))
    return value if value > 0 else None


def _radius(row: Row) -> float | None:
    x, y = row.get("field_x_mm"), row.get("field_y_mm")
    return None if x is None or y is None else round(math.hypot(x, y), 2)


def residual_plot(family: str, by_model: Sequence[Sequence[Row]]) -> str:
    """Residuals z = (measured - simulated) / sigma of a family over its condition, one layer for each model."""
    rows = [row for part in by_model for row in part if row["z"] is not None]
    label, kind, value = axis_of(rows)
    names = list(dict.fromkeys(str(value(r)) for r in rows)) if kind == "names" else []
    place = (lambda r: float(names.index(str(value(r))))) if names else value
    usable = [r for r in rows if place(r) is not None and (kind != "log" or place(r) > 0)]
    if not usable:
        return ""
    xs = [float(place(r)) for r in usable]
    top = max(5.0, min(60.0, max(abs(r["z"]) for r in usable)))
    area = svg.frame((min(xs), max(xs)), (-top, top), log_x=kind == "log" and min(xs) < max(xs))
    band = svg.rect(area.x.start, area.y(2), area.x.end - area.x.start, area.y(-2) - area.y(2), "band")
    ticks = thinned(names) if names else ()
    body = band + area.axes(label, "z", x_names=ticks) + svg.line(area.x.start, area.y(0), area.x.end, area.y(0), "one")
    for i, part in enumerate(by_model):
        body += f'<g class="layer" data-model="{i}">{_points(area, part, place, kind)}</g>'
    return area.svg(body, f"Residuals of {family} in standard deviations over {label}")


def planes_shown(by_model: Sequence[Sequence[Row]]) -> list[tuple[str, str]]:
    """(colour class, plane) of the colour planes that the rows have, for a key under the plots."""
    own = {str(row["channel"]) for row in by_model[0]} if by_model else set()
    kinds: dict[str, list[str]] = {}
    for plane, kind in PLANE_CLASS.items():
        if plane in own:
            kinds.setdefault(kind, []).append(plane)
    return [(kind, ", ".join(planes)) for kind, planes in kinds.items()]


def thinned(names: Sequence[str], room_px: float = 280.0) -> list[str]:
    """Names for an axis, as many of them as stand side by side."""
    short = [_short(name) for name in names]
    widest = max((len(name) for name in short), default=0) * LETTER_PX + 8
    every = max(1, math.ceil(len(names) * widest / room_px))
    return [name if i % every == 0 else "" for i, name in enumerate(short)]


def _short(name: str) -> str:
    return name if len(name) < 11 else name[:9] + "…"


def _points(area: svg.Frame, rows: Sequence[Row], place: Callable[[Row], Any], kind: str) -> str:
    out: list[str] = []
    planes: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        at = place(row)
        if row["z"] is None or at is None or (kind == "log" and at <= 0):
            continue
        spot = (area.x(float(at)), area.y(row["z"]))
        colour = PLANE_CLASS.get(row["channel"], "grey")
        if abs(row["z"]) > FAR_Z:
            out.append(svg.circle(*spot, f"far {colour}", row_words(row)))
        else:
            planes.setdefault(colour, []).append(spot)
    return "".join(svg.dots(spots, colour) for colour, spots in planes.items()) + "".join(out)


def row_words(row: Row) -> str:
    """One metric with both sides and z."""
    where = " ".join(str(row[k]) for k in ("shot", "channel", "region", "patch") if row.get(k))
    values = f"measured {row['measured']:.5g}, simulated {row['simulated']:.5g} {row['unit']}"
    return f"{row['name']} {where}: {values}, z {row['z']:+.1f}"


def transfer_plot(by_model: Sequence[Sequence[Row]]) -> str:
    """Photon transfer: temporal variance over mean, measured as points and simulated as curves."""
    pairs = [_paired(part, "flat_mean", "flat_temporal_variance") for part in by_model]
    if not pairs or len(pairs[0]) < 4:
        return ""
    every = [p for part in pairs for p in part]
    means, variances = [p[1] for p in every if p[1] > 0], [p[2] for p in every if p[2] > 0]
    area = svg.frame((min(means), max(means)), (min(variances), max(variances)), log_x=True, log_y=True)
    body = area.axes("mean above black, DN", "temporal variance, DN²")
    body += _curves(area, pairs)
    return area.svg(body, "Photon transfer: temporal variance over mean")


def _paired(rows: Sequence[Row], first: str, second: str) -> list[tuple[str, float, float, float, float]]:
    """(plane, measured a, measured b, simulated a, simulated b) of two families by shot and plane."""
    a = {(r["shot"], r["channel"]): r for r in rows if r["family"] == first}
    b = {(r["shot"], r["channel"]): r for r in rows if r["family"] == second}
    both = [(k[1], a[k]["measured"], b[k]["measured"], a[k]["simulated"], b[k]["simulated"]) for k in a if k in b]
    return [p for p in both if all(v is not None for v in p)]


def _curves(area: svg.Frame, pairs: Sequence[Sequence[tuple[str, float, float, float, float]]]) -> str:
    body = ""
    for i, part in enumerate(pairs):
        layer = ""
        for plane in dict.fromkeys(p[0] for p in part):
            curve = sorted((area.x(p[3]), area.y(p[4])) for p in part if p[0] == plane and p[3] > 0 and p[4] > 0)
            layer += svg.polyline(curve, f"curve {PLANE_CLASS.get(plane, 'grey')}")
        body += f'<g class="layer" data-model="{i}">{layer}</g>'
    for plane in dict.fromkeys(p[0] for p in pairs[0]):
        spots = [(area.x(p[1]), area.y(p[2])) for p in pairs[0] if p[0] == plane]
        body += svg.dots(spots, PLANE_CLASS.get(plane, "grey"))
    return body


def falloff_plot(by_model: Sequence[Sequence[Row]]) -> str:
    """Relative illumination: means of the field flats over radius, each set-up's middle at 1."""
    layers = [_field_rows(part) for part in by_model]
    if not layers or len({round(p[1], 1) for p in layers[0]}) < 3:
        return ""
    every = [v for part in layers for p in part for v in (p[2], p[3])]
    area = svg.frame((0, max(p[1] for p in layers[0])), (min(every), max(every)))
    body = area.axes("field radius, mm", "relative signal")
    for i, part in enumerate(layers):
        layer = ""
        for plane in dict.fromkeys(p[0] for p in part):
            curve = sorted((area.x(p[1]), area.y(p[3])) for p in part if p[0] == plane)
            layer += svg.polyline(curve, f"curve {PLANE_CLASS.get(plane, 'grey')}")
        body += f'<g class="layer" data-model="{i}">{layer}</g>'
    for plane in dict.fromkeys(p[0] for p in layers[0]):
        spots = [(area.x(p[1]), area.y(p[2])) for p in layers[0] if p[0] == plane]
        body += svg.dots(spots, PLANE_CLASS.get(plane, "grey"))
    return area.svg(body, "Relative illumination over field radius")


def _field_rows(rows: Sequence[Row]) -> list[tuple[str, float, float, float]]:
    """(plane, radius, measured, simulated) of set-ups seen at several places in one light, relative to the innermost place."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        if row["family"] == "flat_mean" and _radius(row) is not None:
            groups.setdefault((row["setup"], row["channel"], f"{_light(row) or 0.0:.4g}"), []).append(row)
    out = []
    for (_, plane, _), members in groups.items():
        if len({_radius(m) for m in members}) < 3:
            continue
        inner = min(members, key=lambda m: _radius(m) or 0.0)
        for m in members:
            measured, simulated = m["measured"] / inner["measured"], m["simulated"] / inner["simulated"]
            out.append((plane, _radius(m) or 0.0, measured, simulated))
    return out


def mtf_plot(by_model: Sequence[Sequence[Row]]) -> str:
    """SFR of all edges over frequency, green channel where there is one."""
    rows = [r for r in by_model[0] if r.get("frequency_cy_px") is not None] if by_model else []
    if len({r["frequency_cy_px"] for r in rows}) < 3:
        return ""
    area = svg.frame((0, max(r["frequency_cy_px"] for r in rows)), (0, 1.05))
    body = area.axes("frequency, cy/px", "SFR")
    for i, part in enumerate(by_model):
        curves: dict[Any, list[tuple[float, float]]] = {}
        for r in part:
            if r.get("frequency_cy_px") is not None and r["simulated"] is not None:
                curves.setdefault((r["shot"], r["channel"], r["name"]), []).append(
                    (area.x(r["frequency_cy_px"]), area.y(r["simulated"]))
                )
        layer = "".join(svg.polyline(sorted(c), f"curve thin {PLANE_CLASS.get(k[1], 'grey')}") for k, c in curves.items())
        body += f'<g class="layer" data-model="{i}">{layer}</g>'
    for plane in dict.fromkeys(r["channel"] for r in rows):
        spots = [(area.x(r["frequency_cy_px"]), area.y(r["measured"])) for r in rows if r["channel"] == plane]
        body += svg.dots(spots, f"small {PLANE_CLASS.get(plane, 'grey')}")
    return area.svg(body, "SFR over frequency")


def patch_plot(by_model: Sequence[Sequence[Row]]) -> str:
    """Chart patches: simulated over measured mean, with the line of equality."""

    def chosen(part: Sequence[Row]) -> list[Row]:
        return [r for r in part if r.get("patch") and r["unit"] == "DN" and r["measured"] is not None and "mean" in r["name"]]

    rows = chosen(by_model[0]) if by_model else []
    if len(rows) < 6:
        return ""
    top = max(r["measured"] for r in rows)
    area = svg.frame((0, top), (0, top))
    body = area.axes("measured, DN above black", "simulated, DN")
    body += svg.line(area.x(0), area.y(0), area.x(top), area.y(top), "one")
    for i, part in enumerate(by_model):
        layer = ""
        for plane in dict.fromkeys(r["channel"] for r in chosen(part)):
            spots = [(area.x(r["measured"]), area.y(r["simulated"])) for r in chosen(part) if r["channel"] == plane]
            layer += svg.dots(spots, PLANE_CLASS.get(plane, "grey"))
        body += f'<g class="layer" data-model="{i}">{layer}</g>'
    return area.svg(body, "Chart patches: simulated over measured")
