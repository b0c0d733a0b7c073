"""Shapes in which the likelihood has many valleys: where among all their values the linear model promises most.

Of a plate nobody knows the order of interference, and a fit that starts one fringe off in a lamp with lines ends where it
started.  What such an effect does is a gain by wavelength at each place, so that the responses of all metrics to narrow bands,
simulated once for a plan and a model, give its columns at any value: column = sum over bands of (d row / d ln light of the band)
times the gain there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from isetval.core.campaign import Shot
from isetval.core.context import Context
from isetval.core.effect import Effect, Scan, parameter
from isetval.core.scene import ChartTarget
from isetval.core.sensor import Roi
from isetval.core.signal import Signal
from isetval.loop.candidates import Candidate
from isetval.loop.evidence import Hypothesis, linear_model
from isetval.loop.prediction import Point
from isetval.loop.problem import Problem
from isetval.loop.signatures import Signature
from isetval.loop.subset_sum import Term, best_with

Float = NDArray[np.float64]
STEP = 0.05  # of the light of one band: levels are straight in it, and noise is a thousandth wider


@dataclass(frozen=True, kw_only=True)
class Band(Effect):
    """A gain of one band of the light: what metrics do with it is what they do with any gain by wavelength, summed."""

    name = "band"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 36.0
    candidate: ClassVar[bool] = False

    gain: float = parameter(0.0, unit="1", low=-1.0, high=1.0, doc="relative gain of the band")
    band_nm: float = parameter(550.0, unit="nm", low=0.0, high=1e5, shape=True, doc="its wavelength, one of the model's")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """More light at one wavelength."""
        if not self.gain or signal.wavelength_nm is None:
            return signal
        return signal.scaled(1 + self.gain * (signal.wavelength_nm == self.band_nm)[:, None, None])


def best_place(problem: Problem, without: Hypothesis, made: Sequence[Signature], klass: str) -> Candidate | None:
    """A further form of an effect that states a `Scan`: where it explains most, alone or beside one other effect.

    Linear about a hypothesis ``without`` it, with the signatures ``made`` of all that is asked for; in a second pass as finely
    as the scan states.  None where one of the forms that are asked for anyhow explains as much.  Its prior is one of as many as
    there are values a whole one apart.
    """
    forms = [s.candidate for s in made if s.candidate.klass == klass]
    scan = forms[0].effect.scan
    if scan is None:
        return None
    others = [s for s in made if s.candidate.klass != klass]
    white = problem.whitened_each([s.columns for s in others])
    beside = [Term(s.candidate.name, w, s.candidate.tau, s.candidate.side) for s, w in zip(others, white, strict=True)]
    responses = band_responses(problem)

    def promised(values: Sequence[float]) -> dict[float, float]:
        placed = [forms[0].effect.changed(**{scan.shape: value}) for value in values]
        columns = [columns_of(problem, scan, effect, [p.name for p in forms[0].parameters], responses) for effect in placed]
        terms = [Term(klass, w, forms[0].tau, forms[0].side) for w in problem.whitened_each(columns)]
        return dict(zip(values, best_with(linear_model(problem, without.fitted, [*terms, *beside]), len(values)), strict=True))

    coarse = promised(scan.values)
    near = max(coarse, key=lambda value: coarse[value])
    asked = [float(c.effect.values()[scan.shape]) for c in forms]
    fine = promised([*asked, near, *scan.around(near)])
    best = max(fine, key=lambda value: fine[value])
    if best in asked:
        return None
    name = f"{klass} ({scan.shape} {best:g})"
    return replace(forms[0], name=name, effect=forms[0].effect.changed(**{scan.shape: best}), prior_weight=1 / scan.count)


def band_responses(problem: Problem) -> Float:
    """Raw derivatives (metrics, bands) by ln of the light of each band of the model, where the problem was made.

    Of the shots that see light; edges have levels of their own, and tell little of colors.
    """
    origin = Point(problem.nominal)
    shots = [shot.name for shot in problem.predictor.shots if _sees_color(shot)]
    there = [Point(origin.model.with_effect(Band(gain=STEP, band_nm=float(nm))), {}) for nm in origin.model.wavelength_nm]
    here, *moved = problem.predictor.derivative_vectors([origin, *there], problem.seeds[:1], only=shots)
    return np.nan_to_num(np.column_stack([(vector - here) / STEP for vector in moved]))


def _sees_color(shot: Shot) -> bool:
    return bool(shot.light) and shot.role != "edge" and shot.given is None


def columns_of(problem: Problem, scan: Scan, effect: Effect, names: Sequence[str], responses: Float) -> Float:
    """Raw columns (metrics, parameters) of an effect that is a gain by wavelength and place, from `band_responses`.

    At the middle of each patch or window: fringes are wider.
    """
    metrics, grid = problem.predictor.table.metrics, problem.nominal.wavelength_nm
    x, y = _places_mm(problem)
    lights = np.array([m.light for m in metrics])
    out = np.zeros((len(metrics), len(names)))
    for name, light in problem.plan.lights.items():
        own = np.flatnonzero((lights == name) & np.isfinite(x) & np.isfinite(y) & responses.any(axis=1))
        if own.size:
            gains = scan.gains(effect, names, grid, x[own], y[own], light.radiance)
            out[own] = np.einsum("rb,pbr->rp", responses[own], gains)
    return out


def _places_mm(problem: Problem) -> tuple[Float, Float]:
    """Where in the field each row was measured, x and y (metrics,), patches of a chart in their boxes; nan: nowhere."""
    metrics, sensor = problem.predictor.table.metrics, problem.nominal.sensor
    x, y = (np.array([value(m) for m in metrics], float) for value in (attrgetter("field_x_mm"), attrgetter("field_y_mm")))
    for shot in problem.predictor.shots:
        if not isinstance(shot.target, ChartTarget):
            continue
        row0, col0 = shot.window[:2] if shot.window else (0, 0)
        boxes = {patch.name: Roi.of(patch.box) for patch in shot.target.patches}
        for i in np.arange(len(metrics))[problem.predictor.rows[shot.name]]:
            if box := boxes.get(metrics[i].patch):
                x[i] = (col0 + (box.col0 + box.col1 - sensor.cols) / 2) * sensor.pixel_um * 1e-3
                y[i] = (row0 + (box.row0 + box.row1 - sensor.rows) / 2) * sensor.pixel_um * 1e-3
    return x, y
