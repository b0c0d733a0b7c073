"""Metric rows and their covariance: a number without sigma and unit does not exist."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError
from isetval.core.jsonable import plain
from isetval.core.shown import Drawn

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Metric:
    """One measured number with its unit, its standard deviation and the conditions it holds under.

    ``family`` groups metrics that belong together in tables and plots (``flat_mean``,
    ``flat_variance``, ``mtf`` ...).  ``summary`` marks numbers derived from other rows (a conversion
    gain from means and variances): they are for people and for stored-metric regressions, and are
    left out of the residual vector, where they would count the same data twice.  ``count`` marks the root
    of a number of rare things (2 sqrt(n + 3/8), Anscombe): not normal where there are none.
    """

    name: str
    value: float
    sigma: float
    unit: str
    family: str = ""
    channel: str = ""
    shot: str = ""
    role: str = ""
    setup: str = ""
    measurement_session: str = ""
    region: str = ""
    field_x_mm: float | None = None
    field_y_mm: float | None = None
    level: float | None = None
    exposure_s: float | None = None
    frequency_cy_px: float | None = None
    orientation: str = ""
    focus_um: float | None = None
    light: str = ""
    patch: str = ""
    frame: int | None = None
    summary: bool = False
    count: bool = False
    reason: str = ""

    def key(self) -> tuple[Any, ...]:
        """What the number is, without the number: equal keys are the same metric of the same plan."""
        return tuple(getattr(self, name) for name in KEY_FIELDS)


METRIC_FIELDS = tuple(f.name for f in fields(Metric))
KEY_FIELDS = ("name", "channel", "shot", "region", "frequency_cy_px", "patch", "frame")


@dataclass(frozen=True)
class Differences:
    """How differences of a block's rows between two models are simulated with common random numbers.

    ``one_frame``: the rows are means, and one frame tells the difference that many would; ``noise_free``: noise moves
    to other phases with what is measured (an edge), so that only without it both sides stay comparable; ``draws``: how
    many specimens the expectation of a rare random pattern is taken over, where noise itself is measured.
    """

    one_frame: bool = False
    noise_free: bool = False
    draws: int = 1


@dataclass(frozen=True, eq=False)
class Block:
    """The metrics of one shot (or one derived group) with their joint sampling covariance.

    ``correlation`` is (n, n) or None for independent rows.  ``shared`` maps the label of a random
    number that other blocks share too (one fixed pattern seen at several exposures) to its loading
    on each row, in the row's unit per standard deviation; ``sigma`` does not contain it.  ``differences`` says how
    two models are compared in these rows.
    """

    metrics: tuple[Metric, ...]
    correlation: Float | None = None
    shared: Mapping[str, Float] = field(default_factory=dict)
    choices: Mapping[str, Any] = field(default_factory=dict)
    differences: Differences = Differences()

    def __post_init__(self) -> None:
        n = len(self.metrics)
        if self.correlation is not None and self.correlation.shape != (n, n):
            raise InputError(f"correlation has shape {self.correlation.shape}; {n} metrics need ({n}, {n})")
        for label, loading in self.shared.items():
            if loading.shape != (n,):
                raise InputError(f"shared column {label!r} has shape {loading.shape}; {n} metrics need ({n},)")


@dataclass(frozen=True, eq=False, repr=False)
class MetricTable(Drawn):
    """All metrics of a campaign: rows, block covariance, columns of shared random numbers.

    The covariance of the values is ``block_diag(D_b R_b D_b) + U U^T`` with the blocks' correlation
    R_b, D_b = diag(sigma) and one column of U for each shared label.  ``choices`` holds what the
    estimators chose from the data (by shot and analysis), so that a simulation can be measured with
    the same choices.  ``notes`` are remarks with reasons: what was dropped, refused or doubtful.
    """

    blocks: tuple[Block, ...]
    choices: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)

    def headline(self) -> str:
        """How many metrics of what."""
        metrics = self.metrics
        families = Counter(m.family for m in metrics)
        largest = ", ".join(f"{count} {family}" for family, count in families.most_common(4))
        more = f" and {len(families) - 4} families more" if len(families) > 4 else ""
        return f"{len(metrics)} metrics of {len({m.shot for m in metrics})} shots: {largest}{more}"

    def to_json(self) -> dict[str, Any]:
        """Rows, notes and settings."""
        return {
            "metrics": plain(self.to_frame().to_dict(orient="records")),
            "notes": list(self.notes),
            "settings": plain(self.settings),
        }

    @cached_property
    def metrics(self) -> tuple[Metric, ...]:
        """All rows, in block order."""
        return tuple(m for block in self.blocks for m in block.metrics)

    @property
    def values(self) -> Float:
        """Values of all rows, (metrics,)."""
        return np.array([m.value for m in self.metrics], dtype=float)

    @property
    def sigma(self) -> Float:
        """Standard deviation of each row, shared random numbers included."""
        own = np.array([m.sigma for m in self.metrics], dtype=float)
        shared = self.shared_columns()
        return np.asarray(np.sqrt(own**2 + (shared**2).sum(axis=1)))

    def shared_columns(self) -> Float:
        """U, (metrics, labels): loadings of the random numbers that several blocks share."""
        labels = sorted({label for block in self.blocks for label in block.shared})
        out = np.zeros((sum(len(b.metrics) for b in self.blocks), len(labels)))
        row = 0
        for block in self.blocks:
            for label, loading in block.shared.items():
                out[row : row + len(block.metrics), labels.index(label)] = loading
            row += len(block.metrics)
        return out

    def covariance(self) -> Float:
        """Dense covariance of all rows, (metrics, metrics)."""
        shared = self.shared_columns()
        out = shared @ shared.T
        row = 0
        for block in self.blocks:
            sigma = np.array([m.sigma for m in block.metrics])
            part = np.diag(sigma**2) if block.correlation is None else block.correlation * np.outer(sigma, sigma)
            n = len(sigma)
            out[row : row + n, row : row + n] += part
            row += n
        return out

    def to_frame(self) -> pd.DataFrame:
        """A tidy table, one row a metric; ``sigma`` includes the shared part."""
        import pandas as pd

        frame = pd.DataFrame([[getattr(m, name) for name in METRIC_FIELDS] for m in self.metrics], columns=list(METRIC_FIELDS))
        frame["sigma"] = self.sigma
        return frame

    def select(self, keep: Iterable[int]) -> MetricTable:
        """The table with only the rows whose number is in ``keep`` (order of the table kept)."""
        wanted = set(keep)
        blocks = []
        row = 0
        for block in self.blocks:
            local = [i for i in range(len(block.metrics)) if row + i in wanted]
            row += len(block.metrics)
            if local:
                blocks.append(_cut(block, local))
        return replace(self, blocks=tuple(blocks))


def _cut(block: Block, rows: Sequence[int]) -> Block:
    index = np.asarray(rows, dtype=int)
    return Block(
        metrics=tuple(block.metrics[i] for i in rows),
        correlation=None if block.correlation is None else block.correlation[np.ix_(index, index)],
        shared={label: loading[index] for label, loading in block.shared.items()},
        choices=block.choices,
        differences=block.differences,
    )
