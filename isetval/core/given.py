"""Metrics that are given: rows that somebody else measured, with their covariance and the method they were measured by."""

from __future__ import annotations

from dataclasses import dataclass, replace

from isetval.core.errors import InputError
from isetval.core.metric import Block, Metric

METHODS = ("own", "lyu2022", "iso12233:2000", "iso12233:2014", "iso12233:2017", "iso12233:2023")


@dataclass(frozen=True, eq=False)
class GivenMetrics:
    """Rows of a shot that stand beside captures or in their place.

    ``block`` holds rows and correlation as the file states them (no shot named yet, see `rows_of`);
    ``method`` names the estimator that the model's side is measured with; ``files`` are those that were
    read, relative to the campaign's folder; ``source`` says in words where the numbers come from.
    """

    block: Block
    method: str = "own"
    files: tuple[str, ...] = ()
    source: str = ""

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError(f"method is {self.method!r}; it needs one of {', '.join(METHODS)}")
        seen: set[tuple[object, ...]] = set()
        for row in self.block.metrics:
            if row.key() in seen:
                raise InputError(f"two rows are both {row_words(row)}; give each condition once")
            seen.add(row.key())


def row_words(row: Metric) -> str:
    """A row's name and conditions, for messages."""
    at = row.region or row.patch or ("" if row.frequency_cy_px is None else f"{row.frequency_cy_px:g} cy/px")
    return " ".join(part for part in (row.name, row.channel, at) if part)


def axis_of(row: Metric) -> float | None:
    """Where a row stands along its axis: field radius in mm, frequency in cy/px or level in DN; None: nowhere."""
    if row.frequency_cy_px is not None:
        return row.frequency_cy_px
    return row.field_x_mm if row.field_x_mm is not None else row.level


def stretched(row: Metric, factor: float) -> Metric:
    """The row at another place of its axis, times ``factor``."""
    if row.frequency_cy_px is not None:
        return replace(row, frequency_cy_px=row.frequency_cy_px * factor)
    if row.field_x_mm is not None:
        return replace(row, field_x_mm=row.field_x_mm * factor)
    return row if row.level is None else replace(row, level=row.level * factor)
