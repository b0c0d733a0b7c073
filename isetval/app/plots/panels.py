"""What all plots share: axes of their own where none are given, one colour for each plane, figures as files."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PLANE_COLORS = {"R": "tab:red", "Gr": "tab:green", "Gb": "tab:olive", "G": "tab:green", "B": "tab:blue", "MONO": "tab:gray"}
DPI = 130  # of pictures inside figures: a screen at 1280 px shows no more


def own_axes(ax: Axes | None, size: tuple[float, float] = (5.5, 4.0)) -> Axes:
    """The given axes, or those of a new figure."""
    if ax is not None:
        return ax
    from matplotlib.figure import Figure

    return Figure(figsize=size, layout="constrained").subplots()


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
