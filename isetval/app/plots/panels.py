"""What all plots share: axes of their own where none are given, one colour for each plane, figures as files."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.patheffects import AbstractPathEffect

PLANE_COLORS = {"R": "tab:red", "Gr": "tab:green", "Gb": "tab:olive", "G": "tab:green", "B": "tab:blue", "MONO": "tab:gray"}
TWO_DECADES = 100.0
DPI = 130  # of pictures inside figures: a screen at 1280 px shows no more


def own_axes(ax: Axes | None, size: tuple[float, float] = (5.5, 4.0)) -> Axes:
    """The given axes, or those of a new figure."""
    if ax is not None:
        return ax
    from matplotlib.figure import Figure

    return Figure(figsize=size, layout="constrained").subplots()


def legible() -> list[AbstractPathEffect]:
    """Path effects of letters on a picture: a white rim, so that they stand out of dark and of grey."""
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=1.6, foreground="white")]


def plain_log(axis: Axes, *names: str) -> None:
    """Logarithmic axes in plain numbers: powers of ten, and 2 and 5 between them where less than two decades are shown.

    ``names`` are "x", "y".  An axis of one value, which has no scale, is opened to a factor of two on both sides.
    """
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    for name in names:
        scale: Axis = getattr(axis, f"{name}axis")
        low, high = scale.get_view_interval()
        if high < 1.01 * low:
            low, high = low / 2, high * 2
            axis.set(**{f"{name}lim": (low, high)})
        scale.set_major_locator(LogLocator(subs=(1, 2, 5) if high < TWO_DECADES * low else (1,)))
        scale.set_major_formatter(StrMethodFormatter("{x:g}"))
        scale.set_minor_formatter(NullFormatter())


def figure_bytes(figure: Figure, kind: str) -> bytes:
    """A figure as ``png``, ``svg`` or ``pdf``; the same figure gives the same bytes."""
    import matplotlib

    stream = io.BytesIO()
    stamps = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {}}[kind]
    with matplotlib.rc_context({"svg.hashsalt": "isetval"}):
        figure.savefig(stream, format=kind, dpi=DPI, metadata=stamps)
    return stream.getvalue()


def pdf_bytes(figures: Sequence[Figure]) -> bytes:
    """Figures as the pages of one PDF."""
    from matplotlib.backends.backend_pdf import PdfPages

    stream = io.BytesIO()
    with PdfPages(stream, metadata={"CreationDate": None}) as pages:
        for figure in figures:
            pages.savefig(figure, dpi=DPI)
    return stream.getvalue()
