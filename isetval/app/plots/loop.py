"""Plots of what the loop says: where a model fails, who is suspected, what a plan could tell."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isetval.app.plots.panels import own_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from isetval.core.metric import MetricTable
    from isetval.loop.comparison import Comparison
    from isetval.loop.identifiability import Identifiability
    from isetval.loop.result import Diagnosis

MOST_BARS = 16  # more of them cannot be read in one figure


def plot_comparison(result: Comparison, ax: Axes | None = None) -> Axes:
    """Mean-square z of the families of metrics, worst on top, one mark a model; 1 agrees within the error bars."""
    axis = own_axes(ax, (7.0, 4.5))
    families = list(dict.fromkeys(row.family for row in result.worst))[:MOST_BARS][::-1]
    for i, model in enumerate(result.models):
        rows = [row for row in result.ladder if row.model == model.name and row.family in families]
        axis.plot([r.mean_square_z for r in rows], [families.index(r.family) for r in rows], "os^D"[i % 4], label=model.name)
    axis.axvspan(0.85, 1.15, color="0.9", zorder=0)
    axis.set_yticks(range(len(families)), families, fontsize="small")
    axis.set(xscale="log", xlabel="mean-square z (1: agrees within the error bars)")
    return _finished(axis)


def plot_diagnosis(result: Diagnosis, ax: Axes | None = None) -> Axes:
    """What each candidate explains on its own, the best on top; named effects are filled, those that fit as well hatched."""
    axis = own_axes(ax, (7.0, 4.0))
    seen = sorted((c for c in result.candidates if c.observable and c.dchi2 > 0), key=lambda c: c.dchi2)[-MOST_BARS:]
    named = {e.name for e in result.effects}
    tied = {name for e in result.effects for name in e.equivalent}
    for i, c in enumerate(seen):
        color = "tab:blue" if c.name in named else "tab:orange" if c.name in tied else "0.7"
        axis.barh(i, c.dchi2, color=color, hatch="//" if c.name in tied else None)
    axis.set_yticks(range(len(seen)), [c.name for c in seen], fontsize="small")
    axis.set(xlabel="explained misfit (delta chi2)", title=result.headline())
    axis.title.set_fontsize("small")
    axis.grid(alpha=0.3, axis="x")
    return axis


def plot_identifiability(result: Identifiability, ax: Axes | None = None) -> Axes:
    """Standard deviation of every parameter over its plausible scale, best known on top; beyond 1 the plan is blind to it."""
    axis = own_axes(ax, (7.0, 6.0))
    shown = sorted((p for p in result.parameters if p.tau > 0 and np.isfinite(p.sigma)), key=lambda p: -p.sigma / p.tau)
    shown = shown[-2 * MOST_BARS :]
    for i, p in enumerate(shown):
        axis.plot(p.sigma / p.tau, i, "o", color="tab:blue" if p.observable else "0.6")
    axis.set_yticks(range(len(shown)), [f"{p.effect}.{p.parameter}" for p in shown], fontsize="x-small")
    axis.axvline(1.0, color="0.5", lw=0.8, ls="--")
    axis.set(xscale="log", xlabel="standard deviation with this plan / plausible scale")
    axis.grid(alpha=0.3)
    return axis


def plot_metrics(result: MetricTable, ax: Axes | None = None) -> Axes:
    """How well each family of metrics is known: relative standard deviation of every row."""
    axis = own_axes(ax, (7.0, 4.5))
    rows = [(m.family, s / abs(m.value)) for m, s in zip(result.metrics, result.sigma, strict=True) if m.value and s > 0]
    families = list(dict.fromkeys(family for family, _ in rows))[::-1]
    place = [families.index(family) + 0.5 * ((i * 0.618) % 1 - 0.5) for i, (family, _) in enumerate(rows)]
    axis.plot([100 * share for _, share in rows], place, ".", ms=3, alpha=0.6)
    axis.set_yticks(range(len(families)), families, fontsize="small")
    axis.set(xscale="log", xlabel="standard deviation of a row / its value (%)")
    axis.grid(alpha=0.3)
    return axis


def _finished(axis: Axes) -> Axes:
    axis.grid(alpha=0.3)
    axis.legend(fontsize="small")
    return axis
