"""The outsider test: patterns without physics, scored on what is left over.

Per metric family: mean, slope and curvature along every condition that varies, and single field points,
patches, lights, channels and orientations.  A pattern that still stands out when every effect of the
catalogue has been tried says "none of those I know", and says where.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from isetval.core.metric import Metric
from isetval.loop.candidates import WIDER
from isetval.loop.fit import Fit
from isetval.loop.problem import Problem
from isetval.loop.unknown_evidence import Patterns

Float = NDArray[np.float64]
AXES = {
    "level": "light level",
    "exposure_s": "exposure time",
    "radius": "field radius",
    "field_x_mm": "x",
    "field_y_mm": "y",
    "frequency_cy_px": "frequency",
    "focus_um": "focus",
}
GROUPS = {
    "channel": "channel",
    "orientation": "orientation",
    "light": "light",
    "patch": "patch",
    "setup": "set-up",
    "region": "region",
    "place": "place",
}
MAX_PER_GROUP = 40  # labels of one condition: more (every region of a scene) would drown the others in look-elsewhere
RIPPLES = (1, 2)  # periods from the middle to the corner: fringes of three and more need more radii than plans have


@dataclass(frozen=True, eq=False)
class Template:
    """A pattern over the metrics: ``values`` (metrics,) and what it says in words."""

    words: str
    values: Float
    family: str


@dataclass(frozen=True, eq=False)
class Conditions:
    """The conditions of a table as columns: values (metrics,) by axis, nan where one has none; labels (metrics,) by group."""

    families: NDArray[np.str_]
    axes: dict[str, Float]
    groups: dict[str, NDArray[np.str_]]

    @classmethod
    def of(cls, metrics: Sequence[Metric]) -> Conditions:
        """Of the metrics of a table."""
        return cls(
            np.array([m.family for m in metrics]),
            {name: _axis(metrics, name) for name in AXES},
            {name: np.array([_label(m, name) for m in metrics]) for name in GROUPS},
        )


def _label(metric: Metric, group: str) -> str:
    if group != "place":
        return str(getattr(metric, group))
    return "" if metric.field_x_mm is None else f"({metric.field_x_mm:.1f}, {metric.field_y_mm or 0.0:.1f}) mm"


def _axis(metrics: Sequence[Metric], name: str) -> Float:
    if name == "radius":
        return np.array([np.hypot(m.field_x_mm or 0.0, m.field_y_mm or 0.0) for m in metrics])
    return np.array([np.nan if getattr(m, name) is None else float(getattr(m, name)) for m in metrics])


def templates(metrics: Sequence[Metric], predicted: Float, sigma: Float) -> Iterator[Template]:
    """All patterns for a table; amplitudes are relative to the predicted value and in units of sigma."""
    conditions = Conditions.of(metrics)
    size = np.where(np.abs(predicted) > 3 * sigma, np.abs(predicted), sigma)
    for family in dict.fromkeys(conditions.families):
        member = conditions.families == family
        for amplitude, kind in ((size, "in proportion"), (sigma, "by sigma")):
            base = np.where(member & np.isfinite(amplitude), amplitude, 0.0)
            yield Template(f"{family}: all values ({kind})", base, family)
            yield from _along_axes(conditions, family, member, base)
        proportional = np.where(member & np.isfinite(size), size, 0.0)
        yield from _ripples(conditions, family, member, proportional)
        yield from _groups(conditions, family, member, proportional)


def _along_axes(conditions: Conditions, family: str, member: NDArray[np.bool_], base: Float) -> Iterator[Template]:
    for name, words in AXES.items():
        x = conditions.axes[name]
        use = member & np.isfinite(x)
        if use.sum() < 3 or np.ptp(x[use]) <= 1e-9 * max(abs(x[use]).max(), 1e-12):
            continue
        middle, half = (x[use].max() + x[use].min()) / 2, np.ptp(x[use]) / 2
        t = np.where(use, (x - middle) / half, 0.0)
        yield Template(f"{family} changes along {words}", base * t, family)
        if np.unique(np.round(t[use], 6)).size > 2:
            yield Template(f"{family} bends along {words}", base * np.where(use, t**2 - np.mean(t[use] ** 2), 0.0), family)


def _ripples(conditions: Conditions, family: str, member: NDArray[np.bool_], base: Float) -> Iterator[Template]:
    """Radial waves of `RIPPLES` periods in both phases, where there are radii enough to see them."""
    radius = np.where(member, conditions.axes["radius"], np.nan)
    known = np.unique(np.round(radius[member], 6))
    if known.size < 4 * max(RIPPLES):
        return
    turn = 2 * np.pi * np.nan_to_num((radius - known[0]) / np.ptp(known))
    for periods in RIPPLES:
        yield Template(f"{family} ripples along field radius, {periods} periods (cosine)", base * np.cos(periods * turn), family)
        yield Template(f"{family} ripples along field radius, {periods} periods (sine)", base * np.sin(periods * turn), family)


def _groups(conditions: Conditions, family: str, member: NDArray[np.bool_], base: Float) -> Iterator[Template]:
    """One label of each condition apart; rows that several conditions set apart are named by the first of them."""
    known: set[bytes] = set()
    for name, words in GROUPS.items():
        labels = conditions.groups[name]
        found = [label for label in dict.fromkeys(labels[member]) if label]
        if not 1 < len(found) <= MAX_PER_GROUP:
            continue
        for label in found:
            apart = member & (labels == label)
            if apart.tobytes() in known:
                continue
            known.add(apart.tobytes())
            yield Template(f"{family} differs for {words} {label}", np.where(apart, base, 0.0), family)
            if name == "orientation":
                yield Template(
                    f"{family} of {label} edges differs and grows with field radius",
                    np.where(labels == label, base * conditions.axes["radius"], 0.0),
                    family,
                )


_KNOWN: WeakKeyDictionary[Problem, Patterns] = WeakKeyDictionary()


def patterns_of(problem: Problem) -> Patterns:
    """All patterns that show in the rows of a problem, whitened; made once for each problem."""
    if problem not in _KNOWN:
        _KNOWN[problem] = _patterns_of(problem)
    return _KNOWN[problem]


def _patterns_of(problem: Problem) -> Patterns:
    metrics = problem.predictor.table.metrics
    sigma = np.sqrt(problem.base.covariance.diagonal())
    made = {t.words: t for t in reversed(list(templates(metrics, problem.base.mean, sigma)))}
    if not made:
        return Patterns((), np.array([], str), np.zeros((problem.keep.size, 0)))
    white = problem.whitened(np.column_stack([np.nan_to_num(t.values) for t in made.values()]))
    shown = np.flatnonzero(np.linalg.norm(white, axis=0) > 0)
    chosen = [list(made.values())[i] for i in shown]
    return Patterns(tuple(t.words for t in chosen), np.array([t.family for t in chosen]), white[:, shown])


def pulled(fits: Sequence[tuple[str, Fit]], *, alpha: float = 0.01, doubted: Sequence[str] = ()) -> list[str]:
    """Nuisances that stand farther from what the laboratory states than all of them together allow.

    ``fits`` are (which captures, their fit).  A pull is at most a unit normal under a true prior, whatever the data
    know of it (Bonferroni over all of them); one beyond that means a wrong prior, or something missing that it answers for.
    Those of which the sum says that the prior is wrong (``doubted``, by label) were fitted with a wider one and are told.
    """
    from scipy.special import ndtr  # as scipy.stats.norm.sf, whose import takes .4 s

    pulls = [(words, f, v) for words, fit in fits for f, v in zip(fit.free, fit.values, strict=True) if f.is_nuisance and f.prior]
    out = []
    for words, f, value in pulls:
        pull = (value - f.center) * f.weight * (float(np.hypot(1.0, WIDER)) if f.label in doubted else 1.0)
        if f.label in doubted or 2 * ndtr(-abs(pull)) * len(pulls) < alpha:
            unit = "" if f.unit == "1" else f" {f.unit}"
            out.append(
                f"{f.label} stands {pull:+.1f} prior sigmas off ({value:.3g}{unit}, {words}): the prior, or what it answers for"
            )
    return out
