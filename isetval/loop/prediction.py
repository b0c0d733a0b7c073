"""What a model predicts for the metrics of a campaign: its plan shot and measured by the same estimators.

The prediction is the mean of several simulated campaigns at the nominal model, plus the difference that
other parameters make with common random numbers (the same streams on both sides).  Only shots whose
light or electronics a parameter changes are simulated again.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.camera.chain import FRONT, ShotSetup, mean_electrons
from isetval.camera.model import CameraModel
from isetval.camera.shooting import camera_with, shot_setup
from isetval.core.cache import Remembered, Store, content_hash
from isetval.core.campaign import Campaign, Shot
from isetval.core.capture import Capture
from isetval.core.context import Mode
from isetval.core.errors import InputError
from isetval.core.metric import Block, Differences, MetricTable
from isetval.core.scene import RenderedTarget
from isetval.core.workers import single_worker
from isetval.loop.gaussian import scatter
from isetval.loop.given_side import in_large_pixels, is_noisy, measured_only, shoot, with_stated_covariance, with_systematic
from isetval.loop.render_error import render_covariance
from isetval.measure.campaign import measure_shot

Float = NDArray[np.float64]
REPLICAS = 16  # the mean of so many adds 1/16 to the variance of a difference, 3 % to its sigma
COVARIANCE_REPLICAS = 4  # stated covariances scatter little; the scatter of all replicas scales them
WORKER_BYTES = 200_000_000  # metrics remembered in each worker: some 200,000 shots of a hundred rows
DERIVATIVE_SEEDS = (101,)  # common random numbers: one draw tells a difference to the second order
# signatures have seeds of their own: what rounding does to a fit must not look like a signature
SIGNATURE_SEEDS = (201,)
RANDOM_SEEDS = (201, 202)
# a specimen's pattern (hot pixels, columns) is one draw: its expectation needs many; a shot takes as many as its blocks say
SPECIMEN_SEEDS = tuple(range(101, 113))
BASE_SEED = 7_000  # replicas have seeds that neither captures nor differences use


@dataclass(frozen=True, eq=False)
class Point:
    """Where a prediction is made: a model and values of the nuisances."""

    model: CameraModel
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class ShotPart:
    """What one worker needs to shoot and measure one shot."""

    model: CameraModel
    setup: ShotSetup
    seed: int
    mode: Mode
    choices: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Base:
    """Mean and covariance of the metrics at the nominal point, from ``replicas`` simulated campaigns.

    ``values`` is (replicas, metrics); ``covariance`` (metrics, metrics) is of one campaign, scaled by
    family and shot to the scatter that the replicas show; ``scale`` (metrics,) holds those factors of sigma.
    """

    mean: Float
    covariance: Float
    values: Float
    scale: Float

    @property
    def replicas(self) -> int:
        """Number of simulated campaigns."""
        return len(self.values)


class Predictor:
    """Predicts the rows of a measured table for any point; remembers every simulated shot.

    Parameters
    ----------
    plan : Campaign
        Its captures are not used.
    table : MetricTable
        The measured rows: predictions come in their order, made with their choices.
    jobs : int
        Worker processes; 1 computes in this process.
    """

    def __init__(self, plan: Campaign, table: MetricTable, *, jobs: int = 1) -> None:
        self.plan = plan.as_plan()
        self.table = table
        self.keys = [m.key() for m in table.metrics]
        self.place = {key: i for i, key in enumerate(self.keys)}
        measured = {m.shot for m in table.metrics}
        self.shots = tuple(shot for shot in self.plan.shots if shot.name in measured)
        self.rows = {shot.name: np.array([i for i, m in enumerate(table.metrics) if m.shot == shot.name]) for shot in self.shots}
        self._row_keys = {name: [self.keys[i] for i in rows] for name, rows in self.rows.items()}
        self._row_digest = {name: content_hash(keys) for name, keys in self._row_keys.items()}
        self.jobs = max(1, min(jobs, os.cpu_count() or 1))
        self.differences = {shot.name: _joint_differences(table, shot.name) for shot in self.shots}
        self._memo = Store(repr((self.plan.name, [shot.name for shot in self.shots])))
        self._pools: list[ProcessPoolExecutor] = []

    def close(self) -> None:
        """Stop the workers; keep what was simulated for the next time."""
        self._memo.save()
        for pool in self._pools:
            pool.shutdown(wait=False, cancel_futures=True)
        self._pools = []

    def parts(self, point: Point, seed: int, *, derivative: bool) -> list[ShotPart]:
        """The shots of a point, each with its choices."""
        camera = camera_with(point.model, self.plan, point.values)
        return [self._part(camera, shot, point.values, seed, derivative) for shot in self.shots]

    def _part(self, camera: CameraModel, shot: Shot, values: Mapping[str, float], seed: int, derivative: bool) -> ShotPart:
        how = self.differences[shot.name]
        if derivative and how.one_frame:
            shot = replace(shot, frames=1)
        mode: Mode = "capture" if not derivative else "expected" if how.noise_free else "derivative"
        choices = {key: made for key, made in self.table.choices.items() if key.startswith(f"{shot.name}/")}
        choices = with_systematic(choices, self.plan, shot, values)
        camera, setup = in_large_pixels(camera, shot_setup(self.plan, shot, values), choices)
        return ShotPart(camera, setup, seed if is_noisy(shot, choices) else 0, mode, choices)

    def derivative_vectors(
        self, points: Sequence[Point], seeds: Sequence[int] = DERIVATIVE_SEEDS, *, of_noise: bool = False
    ) -> list[Float]:
        """Metrics (metrics,) at each point, mean over ``seeds`` of common random numbers.

        Of ``seeds`` each shot uses as many as the `Differences` of its blocks say.  With ``of_noise`` only shots in which
        noise itself is measured are simulated (means elsewhere do not feel it); the rows of the others are nan.
        """
        shots = [shot for shot in self.shots if not (of_noise and self.differences[shot.name].one_frame)]
        draws = [(shot, seed) for shot in shots for seed in seeds[: self.differences[shot.name].draws]]
        cameras = [camera_with(point.model, self.plan, point.values) for point in points]
        tasks = [
            self._part(camera, shot, point.values, seed, True)
            for point, camera in zip(points, cameras, strict=True)
            for shot, seed in draws
        ]
        results = iter(self._vectors(tasks))
        count = {shot.name: sum(other is shot for other, _ in draws) for shot in shots}
        out = []
        for _ in points:
            total = np.full(len(self.keys), np.nan)
            for shot in shots:
                total[self.rows[shot.name]] = 0.0
            for shot, _ in draws:
                total[self.rows[shot.name]] += next(results) / count[shot.name]
            out.append(total)
        return out

    def base(self, point: Point, replicas: int = REPLICAS) -> Base:
        """Mean, covariance and scatter of ``replicas`` simulated campaigns, each with its own specimen."""
        tasks = [part for r in range(replicas) for part in self.parts(point, BASE_SEED + r, derivative=False)]
        count = min(COVARIANCE_REPLICAS, replicas)
        first = tasks[: count * len(self.shots)]
        blocks = iter(self._run(_blocks_of, first))
        tables = [MetricTable(tuple(b for _ in self.shots for b in next(blocks))) for _ in range(count)]
        vectors = iter(self._vectors(tasks[len(first) :]))
        values = np.zeros((replicas, len(self.keys)))
        for r, table in enumerate(tables):
            order = self._order(table)
            values[r] = np.where(order < 0, np.nan, table.values[order])
        for r in range(count, replicas):
            for shot in self.shots:
                values[r, self.rows[shot.name]] = next(vectors)
        covariance = np.mean([_ordered(t.covariance(), self._order(t)) for t in tables], axis=0)
        scale = scatter(values, measured_only(covariance, self.table), self.table.metrics)
        covariance = covariance * np.outer(scale, scale) + self._of_renders(tasks[: len(self.shots)])
        covariance = with_stated_covariance(covariance, self.table, replicas)
        return Base(values.mean(axis=0), covariance, values, scale)

    def _of_renders(self, tasks: list[ShotPart]) -> Float:
        """Covariance from the noise of renders, which all replicas share and so do not show."""
        out = np.zeros((len(self.keys), len(self.keys)))
        rendered = [task for task in tasks if isinstance(task.setup.shot.target, RenderedTarget)]
        for task, part in zip(rendered, self._run(_render_part, rendered, self._rows_of), strict=True):
            rows = self.rows[task.setup.shot.name]
            if part is not None:
                out[np.ix_(rows, rows)] = part
        return out

    def _order(self, table: MetricTable) -> NDArray[np.intp]:
        place = {m.key(): i for i, m in enumerate(table.metrics)}
        return np.array([place.get(key, -1) for key in self.keys])

    def _vectors(self, tasks: list[ShotPart]) -> list[Float]:
        """Measured values of each task; equal content is simulated once."""
        keys = [content_hash((_content(task), self._row_digest[task.setup.shot.name])) for task in tasks]
        missing: dict[str, ShotPart] = {}
        for key, task in zip(keys, tasks, strict=True):
            if self._memo.get(key) is None:
                missing.setdefault(key, task)
        vectors = self._run(_vector_of, list(missing.values()), self._rows_of)
        for key, vector in zip(missing, vectors, strict=True):
            self._memo.put(key, vector)
        return [self._memo.items[key] for key in keys]

    def _rows_of(self, task: ShotPart) -> list[Any]:
        return self._row_keys[task.setup.shot.name]

    def _run(self, function: Any, tasks: list[ShotPart], extra: Any = None) -> list[Any]:
        jobs = [(task, extra(task)) if extra else (task,) for task in tasks]
        if self.jobs == 1 or len(jobs) < 4:
            return [function(*job) for job in jobs]
        if not self._pools:
            self._pools = [single_worker() for _ in range(self.jobs)]
        names = [shot.name for shot in self.shots]
        futures = [
            self._pools[names.index(task.setup.shot.name) % self.jobs].submit(function, *job)
            for task, job in zip(tasks, jobs, strict=True)
        ]
        return [future.result() for future in futures]


def _content(task: ShotPart) -> Any:
    """Equal for two tasks that must give the same numbers."""
    model = task.model
    front = tuple(e.content() for e in model.effects if e.stage in FRONT)
    rest = tuple(e.content() for e in model.effects if e.stage not in FRONT)
    made = (front, task.setup.digest(), rest, task.setup.shot.name, task.setup.shot.frames)
    return (model.sensor, model.wavelength_nm.tobytes(), made, task.seed, task.mode, task.choices)


def _ordered(covariance: Float, order: NDArray[np.intp]) -> Float:
    out = covariance[np.ix_(order, order)]
    out[order < 0] = np.nan
    out[:, order < 0] = np.nan
    return np.asarray(out)


_MEASURED = Remembered(WORKER_BYTES)


def _vector_of(task: ShotPart, keys: Sequence[Any]) -> Float:
    """Values of ``keys`` for one shot; equal light and electronics are shot and measured once per process.

    Unlike the store, which knows what a shot is made from, this one knows the light that came out: a parameter
    that does not touch the shot costs nothing but the light.
    """
    mean = mean_electrons(task.model, task.setup)
    rest = tuple(e.content() for e in task.model.effects if e.stage not in FRONT)
    shot = task.setup.shot
    key = content_hash(
        (mean, rest, shot.name, shot.frames, task.seed, task.mode, task.choices, hash(tuple(keys)), task.model.sensor)
    )
    found = _MEASURED.get(key)
    if found is None:
        values = {m.key(): m.value for block in _blocks_of(task) for m in block.metrics}
        found = np.array([values.get(k, np.nan) for k in keys])
        _MEASURED.put(key, found)
    return found


def _render_part(task: ShotPart, keys: Sequence[Any]) -> Float | None:
    one = replace(task.setup, shot=replace(task.setup.shot, frames=1))

    def measure(captures: Sequence[Capture]) -> Float:
        try:
            blocks = [block for _, block in measure_shot(one.shot, captures, choices=task.choices)]
        except InputError:
            blocks = []
        values = {m.key(): m.value for block in blocks for m in block.metrics}
        return np.array([values.get(k, np.nan) for k in keys])

    return render_covariance(task.model, one, measure)


def _joint_differences(table: MetricTable, shot: str) -> Differences:
    """What the blocks of one shot together ask of a difference."""
    asked = [block.differences for block in table.blocks if block.metrics and block.metrics[0].shot == shot]
    return Differences(
        one_frame=all(d.one_frame for d in asked),
        noise_free=all(d.noise_free for d in asked),
        draws=max((d.draws for d in asked), default=1),
    )


def _blocks_of(task: ShotPart) -> list[Block]:
    captures = shoot(task.model, task.setup, task.seed, mode=task.mode, choices=task.choices)
    try:
        return [block for _, block in measure_shot(task.setup.shot, captures, choices=task.choices)]
    except InputError:
        return []
