"""Find the further capture that would tell two candidates apart.

Each proposal adds shots to the plan; the signatures of both candidates and the nuisances' are simulated
on those shots alone, and the profiled cosine of the pair is computed again with them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from isetval.camera.shooting import simulate
from isetval.core.campaign import Campaign, Light, Shot
from isetval.core.errors import InputError
from isetval.core.parameter import Parameter
from isetval.core.scene import EdgeTarget, Spectrum
from isetval.core.sensor import Exposure, Window
from isetval.loop.candidates import Candidate
from isetval.loop.derivatives import jacobian, nuisance_parameters
from isetval.loop.fit import Fit
from isetval.loop.gaussian import orthonormal_basis, with_priors
from isetval.loop.prediction import Point, Predictor
from isetval.loop.problem import Problem
from isetval.loop.result import NextCapture
from isetval.loop.score_test import Frame, cosine, make_frame
from isetval.loop.signatures import Signature, signatures
from isetval.loop.task_runner import Call
from isetval.loop.weighing import make_problem
from isetval.measure.campaign import measure_campaign

Float = NDArray[np.float64]
REPLICAS = 3  # a proposal's covariance is needed to a factor, not to a percent
KEEP = 6  # proposals that a person can weigh
WORTH = 0.02  # smallest fall of the cosine that is told: above its own simulation error
PART_PX = 96  # side of the windows that stand for a whole field


def proposals(plan: Campaign) -> Iterator[tuple[str, Campaign]]:
    """Named extra captures for a plan, each as a small plan of its own."""
    flats = [part for s in plan.shots if s.role == "flat" for part in _parts(s)]
    edges = [s for s in plan.shots if s.role == "edge"]
    charts = [s for s in plan.shots if s.role == "chart"]
    darks = [s for s in plan.shots if s.role == "dark"]
    if flats:
        far = sorted(flats, key=lambda s: _radius(s, plan), reverse=True)[:6]
        yield "field flats with the camera rotated 180 deg", _plan(plan, far, "rotated", rotation_deg=180.0)
        brightest = max(flats, key=lambda s: (s.exposure.time_s or 0) * s.light_level)
        yield "flats above saturation", _plan(plan, [_longer(brightest, 2.0), _longer(brightest, 4.0)], "saturated")
        ramp = [replace(brightest, light_level=brightest.light_level * f) for f in (0.06, 0.12, 0.25, 0.5, 0.75)]
        yield "flats by light level at fixed exposure time", _plan(plan, ramp, "by level", setup=None)
        ramp = [_longer(brightest, f) for f in (0.01, 0.03, 0.1, 0.3, 0.6)]
        yield "flats by exposure time at fixed light, 16 frames", _plan(plan, ramp, "by time", frames=16)
    if darks:
        longest = max(darks, key=lambda s: s.exposure.time_s or 0)
        more = [_longer(longest, f) for f in (0.001, 0.1, 1.0, 4.0)]
        yield "dark series over four exposure times, 16 frames", _plan(plan, more, "dark series", frames=16)
    if edges:
        yield from _edge_proposals(plan, edges)
    if charts:
        narrow = _narrow_lights(plan, charts[0])
        shots = [replace(charts[0], light=light.name) for light in narrow.values()]
        yield (
            "chart under three narrow-band lights",
            _plan(replace(plan, lights={**plan.lights, **narrow}), shots, "narrow", setup=None),
        )


def _parts(flat: Shot) -> list[Shot]:
    """The flat, or windows of a whole field that is only known from a table: whole frames would take minutes to simulate."""
    window = flat.window
    if flat.given is None or window is None or max(window.shape) <= 2 * PART_PX:
        return [flat]
    row, col = (n - PART_PX for n in window.shape)
    places = [(0.5, 0.5), (0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0), (0.25, 0.75)]
    corners = [(int(window.row0 + a * row) // 2 * 2, int(window.col0 + b * col) // 2 * 2) for a, b in places]
    return [replace(flat, window=Window(r, c, PART_PX, PART_PX)) for r, c in corners]


def _edge_proposals(plan: Campaign, edges: Sequence[Shot]) -> Iterator[tuple[str, Campaign]]:
    first = edges[0]
    sweep = [replace(first, focus_um=f) for f in (-12.0, -6.0, 0.0, 6.0, 12.0)]
    yield "edges through focus, five steps", _plan(plan, sweep, "focus sweep")
    narrow = _narrow_lights(plan, first)
    shots = [replace(first, light=light.name) for light in narrow.values()]
    yield (
        "edges under three narrow-band lights",
        _plan(replace(plan, lights={**plan.lights, **narrow}), shots, "narrow edges", setup=None),
    )
    turned = [replace(e, target=_turned(e)) for e in edges[:4]]
    yield "horizontal and vertical edges at the same places", _plan(plan, turned, "turned")


def _turned(shot: Shot) -> EdgeTarget:
    target = shot.target
    assert isinstance(target, EdgeTarget)
    orientation = "horizontal" if target.orientation == "vertical" else "vertical"
    return replace(target, orientation=orientation)


def _narrow_lights(plan: Campaign, shot: Shot) -> dict[str, Light]:
    base = plan.lights[shot.light or next(iter(plan.lights))].radiance
    grid = np.arange(390.0, 711.0, 5.0)
    total = float(np.trapezoid(base.at(grid), grid))
    out = {}
    for center in (460.0, 540.0, 620.0):
        line = np.exp(-0.5 * ((grid - center) / 12.0) ** 2)
        out[f"narrow {center:.0f} nm"] = Light(
            f"narrow {center:.0f} nm", Spectrum(grid, 0.5 * total * line / np.trapezoid(line, grid))
        )
    return out


def _longer(shot: Shot, factor: float) -> Shot:
    return replace(shot, exposure=Exposure((shot.exposure.time_s or 0.001) * factor, shot.exposure.iso))


def _radius(shot: Shot, plan: Campaign) -> float:
    window, sensor = shot.window, plan.sensor
    if window is None or sensor is None:
        return 0.0
    return float(np.hypot(window[0] + window[2] / 2 - sensor.rows / 2, window[1] + window[3] / 2 - sensor.cols / 2))


def _plan(plan: Campaign, shots: Sequence[Shot], label: str, *, setup: str | None = "", **changes: object) -> Campaign:
    new = []
    for i, shot in enumerate(shots):
        own = f"{label} {i}" if setup is None else label
        changed = {"repeat_of": None, "files": (), "given": None, **changes}
        new.append(replace(shot, name=f"{label} {i}", setup=own, **changed))  # type: ignore[arg-type]
    return replace(plan.as_plan(), shots=tuple(new), folder=None)


def next_captures(
    problem: Problem, fitted: Fit, pairs: Sequence[tuple[Signature, Signature]], *, keep: int | None = KEEP
) -> list[NextCapture]:
    """The ``keep`` proposals that lower the cosine of the given pairs most (None: all that lower one), best first."""
    if not pairs:
        return []
    start = Point(problem.nominal)
    frame = make_frame(fitted)
    before = {(a.candidate.name, b.candidate.name): _pair_cosine(problem, frame, a, b) for a, b in pairs}
    wanted = list({s.candidate.name: s.candidate for pair in pairs for s in pair}.values())
    offered = list(proposals(problem.plan))
    calls = [Call(shown_by, (plan, start, wanted), i) for i, (_, plan) in enumerate(offered)]
    shown = dict(problem.predictor.over_workers(calls))
    out = []
    for i, (label, _) in enumerate(offered):
        for a, b in pairs if shown[i] is not None else ():
            names = (a.candidate.name, b.candidate.name)
            after = _joint_cosine(problem, fitted, (a, b), shown[i])
            if before[names] - after > WORTH:
                out.append(NextCapture(label, names, before[names], after))
    out.sort(key=lambda c: c.rho_before**2 - c.rho_after**2, reverse=True)
    return out[:keep]


@dataclass(frozen=True, eq=False)
class Shown:
    """What further shots show: whitened columns (rows, parameters) of the nuisances ``free``, and of candidates by name."""

    free: tuple[Parameter, ...]
    nuisances: Float
    candidates: Mapping[str, Float]


def shown_by(plan: Campaign, start: Point, wanted: Sequence[Candidate]) -> Shown | None:
    """What the shots of a small plan would show of candidates; None where they cannot be measured."""
    try:
        shot = simulate(start.model, plan, seed=3)
        predictor = Predictor(plan, measure_campaign(shot), usual=[e.name for e in start.model.effects], jobs=1)
        extra = make_problem(predictor, start, base=predictor.base(start, REPLICAS))
    except InputError:
        return None
    made = signatures(extra, start, wanted, project=np.zeros((extra.keep.size, 0)))
    free = nuisance_parameters(extra.plan, start.model)
    columns = jacobian(extra, start, free)
    predictor.close()
    each = extra.whitened_each([s.columns for s in made])
    return Shown(free, columns, {s.candidate.name: white for s, white in zip(made, each, strict=True)})


def _pair_cosine(problem: Problem, frame: Frame, a: Signature, b: Signature) -> float:
    return cosine(frame, problem.whitened(a.columns), problem.whitened(b.columns))


def _joint_cosine(problem: Problem, fitted: Fit, pair: tuple[Signature, Signature], extra: Shown) -> float:
    """The cosine on both plans together; nuisances with the same label are shared."""
    own = list(fitted.free)
    known = {f.label for f in own}
    new = [f for f in extra.free if f.label not in known]
    place = {f.label: i for i, f in enumerate([*own, *new])}
    top = np.zeros((problem.keep.size, len(place)))
    top[:, : len(own)] = fitted.jacobian
    bottom = np.zeros((len(extra.nuisances), len(place)))
    bottom[:, [place[f.label] for f in extra.free]] = extra.nuisances
    matrix, priors = with_priors(np.vstack([top, bottom]), [*own, *new])
    rows = problem.keep.size + len(bottom)
    frame = Frame(np.zeros(rows + priors.size), orthonormal_basis(matrix), rows)
    white = [np.vstack([problem.whitened(s.columns), extra.candidates[s.candidate.name]]) for s in pair]
    return cosine(frame, white[0], white[1])
