"""The curve of a named effect whose own form does not do: as found, with its band, and in its own form."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from isetval.app.report import svg

STROKES = {"R": "red", "G": "green", "B": "blue", "": "grey"}


def form_plot(effect: Mapping[str, Any]) -> str:
    """Two standard deviations about the curve found, and the effect's own form dashed; empty without a curve."""
    curve = effect.get("curve")
    if not curve:
        return ""
    at = curve["at"]
    bands = {
        color: [(v - 2 * s, v + 2 * s) for v, s in zip(curve["value"][color], curve["sigma"][color], strict=True)]
        for color in curve["value"]
    }
    every = [v for band in bands.values() for ends in band for v in ends] + [v for own in curve["own"].values() for v in own]
    area = svg.frame((at[0], at[-1]), (min(every), max(every)))
    body = area.axes(f"{curve['axis']}, {curve['unit']}", curve["quantity"])
    for color, band in bands.items():
        stroke = STROKES.get(color, "grey")
        low = [(area.x(x), area.y(ends[0])) for x, ends in zip(at, band, strict=True)]
        high = [(area.x(x), area.y(ends[1])) for x, ends in zip(at, band, strict=True)]
        body += svg.area([*low, *reversed(high)], f"sigma {stroke}")
        body += svg.polyline(_points(area, at, curve["own"][color]), "curve one")
        body += svg.polyline(_points(area, at, curve["value"][color]), f"curve {stroke}")
    return area.svg(body, f"{effect['name']}: its form as found over {curve['axis']}, and its own form (dashed)")


def _points(area: svg.Frame, at: list[float], values: list[float]) -> list[tuple[float, float]]:
    return [(area.x(x), area.y(y)) for x, y in zip(at, values, strict=True)]
