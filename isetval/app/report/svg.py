"""Small plots as inline SVG: scales, ticks, axes, points, lines, bars."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape


@dataclass(frozen=True)
class Scale:
    """A linear or logarithmic scale from data to pixels."""

    low: float
    high: float
    start: float
    end: float
    log: bool = False

    def __call__(self, value: float) -> float:
        """The place of a value; values outside stick to the ends."""
        low, high = (math.log10(self.low), math.log10(self.high)) if self.log else (self.low, self.high)
        at = math.log10(max(value, self.low)) if self.log else value
        share = (at - low) / (high - low) if high > low else 0.5
        return self.start + min(max(share, 0.0), 1.0) * (self.end - self.start)

    def ticks(self, count: int = 5) -> list[float]:
        """Round values inside the scale."""
        return _log_ticks(self.low, self.high) if self.log else _linear_ticks(self.low, self.high, count)


def _linear_ticks(low: float, high: float, count: int) -> list[float]:
    if not high > low:
        return [low]
    raw = (high - low) / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(power * m for m in (1, 2, 5, 10) if power * m >= raw * 0.999)
    first = math.ceil(low / step - 1e-9)
    return [i * step for i in range(first, math.floor(high / step + 1e-9) + 1)]


def _log_ticks(low: float, high: float) -> list[float]:
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    marks = (1,) if len(powers) > 3 else (1, 2, 5)
    return [m * 10.0**p for p in powers for m in marks if low * 0.999 <= m * 10.0**p <= high * 1.001]


def tick_words(value: float) -> str:
    """A number on an axis."""
    if value == 0:
        return "0"
    return (f"{value:.0e}" if abs(value) >= 1e5 or abs(value) < 1e-3 else f"{value:.4g}").replace("e-0", "e-").replace("e+0", "e")


def text(x: float, y: float, words: str, *, anchor: str = "middle", kind: str = "") -> str:
    """A label."""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" class="{kind}">{escape(words)}</text>'


def line(x1: float, y1: float, x2: float, y2: float, kind: str) -> str:
    """A straight line."""
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" class="{kind}"/>'


def rect(x: float, y: float, width: float, height: float, kind: str, *, title: str = "") -> str:
    """A bar or a band."""
    hint = f"<title>{escape(title)}</title>" if title else ""
    return f'<rect x="{x:.1f}" y="{y:.1f}" width="{max(width, 0):.1f}" height="{max(height, 0):.1f}" class="{kind}">{hint}</rect>'


def dots(points: Sequence[tuple[float, float]], kind: str) -> str:
    """Many round points as one path."""
    path = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in points)
    return f'<path d="{path}" class="dots {kind}"/>' if path else ""


def circle(x: float, y: float, kind: str, title: str) -> str:
    """One point that says what it is when pointed at, touched, or reached by the keyboard."""
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.2" class="{kind}" tabindex="0"><title>{escape(title)}</title></circle>'


def area(points: Sequence[tuple[float, float]], kind: str) -> str:
    """A filled band between two curves, given as one closed line."""
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polygon points="{path}" class="{kind}"/>'


def polyline(points: Sequence[tuple[float, float]], kind: str) -> str:
    """A curve."""
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline points="{path}" class="{kind}"/>' if len(points) > 1 else ""


@dataclass(frozen=True)
class Frame:
    """A plot area with its two scales."""

    x: Scale
    y: Scale
    width: float
    height: float

    def axes(self, x_label: str, y_label: str, *, x_names: Sequence[str] = ()) -> str:
        """Grid, ticks and labels."""
        left, right, top, bottom = self.x.start, self.x.end, self.y.end, self.y.start
        parts = [
            line(left, self.y(v), right, self.y(v), "grid") + text(left - 5, self.y(v) + 3.5, tick_words(v), anchor="end")
            for v in self.y.ticks()
        ]
        if x_names:
            parts += [text(self.x(i), bottom + 13, name) for i, name in enumerate(x_names) if name]
        else:
            parts += [
                line(self.x(v), bottom, self.x(v), bottom + 3, "tick") + text(self.x(v), bottom + 14, tick_words(v))
                for v in self.x.ticks()
            ]
        parts.append(line(left, bottom, right, bottom, "axis"))
        parts.append(text((left + right) / 2, self.height - 4, x_label, kind="label"))
        parts.append(f'<g transform="translate(11,{(top + bottom) / 2:.1f}) rotate(-90)">{text(0, 0, y_label, kind="label")}</g>')
        return "".join(parts)

    def svg(self, body: str, title: str) -> str:
        """The finished picture."""
        return (
            f'<svg viewBox="0 0 {self.width:g} {self.height:g}" role="img" aria-label="{escape(title)}">'
            f"<title>{escape(title)}</title>{body}</svg>"
        )


def frame(
    x: tuple[float, float],
    y: tuple[float, float],
    *,
    size: tuple[float, float] = (360, 220),
    log_x: bool = False,
    log_y: bool = False,
) -> Frame:
    """A plot area for data ranges ``x`` and ``y``."""
    width, height = size
    return Frame(
        Scale(*padded(x, log=log_x), 62, width - 16, log_x), Scale(*padded(y, log=log_y), height - 36, 10, log_y), width, height
    )


def padded(ends: tuple[float, float], *, log: bool = False, share: float = 0.05) -> tuple[float, float]:
    """A range with room at both ends."""
    low, high = ends
    if log:
        factor = max((high / low) ** share, 1.05)
        return low / factor, high * factor
    room = (high - low) * share or abs(high) * share or 1.0
    return low - room, high + room
