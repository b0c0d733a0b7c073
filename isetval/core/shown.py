"""Results that show themselves: one line for a prompt, a table and a picture for a notebook, JSON for programs.

Nothing here draws.  The package names the module that can (`drawn_by`), which stands above everything that is drawn, and it is
loaded when the first picture is asked for.
"""

from __future__ import annotations

import dataclasses
import importlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any, Protocol, cast

from isetval.core.jsonable import plain

if TYPE_CHECKING:
    import pandas as pd

SHOWN_ROWS = 12  # of a table under its picture: what a screen shows without scrolling


class Drawing(Protocol):
    """What the module that draws offers."""

    def draw(self, result: Any, ax: Any = None) -> Any:
        """The result's main picture in ``ax`` or in a figure of its own; the axes."""

    def picture_url(self, result: Any) -> str:
        """The same as a PNG in a ``data:`` address."""


_drawn_by: list[str] = []


def drawn_by(module: str) -> None:
    """Name the module that draws results; it is imported with the first picture."""
    _drawn_by[:] = [module]


def _drawing() -> Drawing:
    return cast(Drawing, importlib.import_module(_drawn_by[0]))


class Shown(ABC):
    """A result with a short ``repr``, a tidy table and plain JSON."""

    @abstractmethod
    def headline(self) -> str:
        """What the result says, in one line."""

    @abstractmethod
    def to_frame(self) -> pd.DataFrame:
        """A tidy table."""

    def to_json(self) -> Any:
        """All fields as plain numbers and words; None for what is not finite."""
        return plain_fields(self)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.headline()})"

    def _repr_html_(self) -> str:
        head = f"<p><b>{type(self).__name__}</b>: {escape(self.headline())}</p>"
        return head + self._picture_html() + _table_html(self.to_frame())

    def _picture_html(self) -> str:
        return ""


class Drawn(Shown):
    """A result that has a picture as well."""

    def plot(self, ax: Any = None) -> Any:
        """Draw the result into ``ax`` (matplotlib axes), or into a figure of its own; returns the axes."""
        return _drawing().draw(self, ax)

    def _picture_html(self) -> str:
        return f'<img alt="{escape(self.headline())}" src="{_drawing().picture_url(self)}">'


def _table_html(frame: pd.DataFrame) -> str:
    text = frame.head(SHOWN_ROWS).to_html(index=False, border=0, float_format=lambda v: f"{v:.5g}", na_rep="")
    left = len(frame) - SHOWN_ROWS
    return text + (f"<p>and {left} more rows: .to_frame()</p>" if left > 0 else "")


def plain_fields(value: Any) -> Any:
    """``value`` as JSON holds it: dataclasses by their public fields, arrays as lists."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain_fields(getattr(value, f.name)) for f in dataclasses.fields(value) if f.repr}
    if isinstance(value, Mapping):
        return {str(k): plain_fields(v) for k, v in value.items()}
    if isinstance(value, list | tuple) and not all(isinstance(v, int | float | str) for v in value):
        return [plain_fields(v) for v in value]
    return plain(value)
