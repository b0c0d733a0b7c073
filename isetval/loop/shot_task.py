"""One shot of a prediction: what a worker needs to shoot and measure it, and by which content its numbers are remembered."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.camera.chain import FRONT, ShotSetup, mean_electrons
from isetval.camera.model import CameraModel
from isetval.core.cache import Remembered, bytes_hash, content_hash
from isetval.core.capture import Capture
from isetval.core.context import Mode
from isetval.core.errors import InputError
from isetval.core.metric import Block, MetricTable
from isetval.loop.given_side import shoot
from isetval.loop.render_error import render_covariance
from isetval.measure.campaign import measure_across, measure_shot

Float = NDArray[np.float64]
WORKER_BYTES = 200_000_000  # metrics remembered in each worker: some 200,000 shots of a hundred rows
HELD_PIXELS = 20_000_000  # 40 MB of frames that are measured together
LABEL_DIGITS = 13  # hexadecimal: 52 bits, which a double holds exactly


@dataclass(frozen=True)
class Halves:
    """SHA-256 of a camera's two halves: what acts up to the colour filters, and the electronics; both with the sensor."""

    front: str
    rest: str

    @classmethod
    def of(cls, model: CameraModel) -> Halves:
        """Of a model."""
        front = tuple(e.content() for e in model.effects if e.stage in FRONT)
        rest = tuple(e.content() for e in model.effects if e.stage not in FRONT)
        return cls(content_hash((model.sensor, model.wavelength_nm, front)), content_hash((model.sensor, rest)))


@dataclass(frozen=True)
class Rows:
    """Keys of the rows that are wanted of a shot, and their hash."""

    keys: tuple[Any, ...]
    digest: str

    @classmethod
    def of(cls, keys: Sequence[Any]) -> Rows:
        """Of keys of metrics."""
        return cls(tuple(keys), content_hash(keys))

    def places(self, keys: Sequence[Any]) -> NDArray[np.intp]:
        """Where some of the rows stand among all."""
        place = {key: i for i, key in enumerate(self.keys)}
        return np.array([place[key] for key in keys], dtype=np.intp)

    def order(self, blocks: Sequence[Block]) -> NDArray[np.intp]:
        """Places of the rows in the blocks' metrics, -1 where one is missing."""
        place = {m.key(): i for i, m in enumerate(m for block in blocks for m in block.metrics)}
        return np.array([place.get(key, -1) for key in self.keys], dtype=np.intp)

    def values(self, blocks: Sequence[Block]) -> Float:
        """Values of the rows, nan where one is missing."""
        values = {m.key(): m.value for block in blocks for m in block.metrics}
        return np.array([values.get(key, np.nan) for key in self.keys])


@dataclass(frozen=True, eq=False)
class ShotPart:
    """What one worker needs to shoot and measure one shot; ``halves`` and ``chosen`` are the hashes of model and choices.

    ``of`` is the name of the plan's shot, of which the simulated one may bear another (`isetval.loop.stand_ins`).
    Frames are ``rounded`` to codes where their estimators count codes, or where noise is too narrow for a dither to stand for
    it: differences of frames that are not follow their parameters without steps.  Effects that ``mirrored`` names draw their
    unit normals with the other sign.  ``flicker`` is what the plan states of the light from frame to frame.
    """

    model: CameraModel
    setup: ShotSetup
    seed: int
    mode: Mode
    choices: Mapping[str, Any]
    halves: Halves
    chosen: str
    of: str
    rounded: bool = True
    mirrored: frozenset[str] = frozenset()
    flicker: float = 0.0

    @cached_property
    def key(self) -> str:
        """Equal for two tasks that must give the same numbers."""
        return bytes_hash(f"{self.halves.front} {self.setup.digest()} {self._rest}".encode())

    @property
    def _rest(self) -> str:
        shot = self.setup.shot
        frames = (shot.frames, self.setup.stands_for, self.setup.before_digest)
        turned = sorted(self.mirrored)
        return repr(
            (self.halves.rest, shot.name, *frames, self.seed, self.mode, self.rounded, self.chosen, self.flicker, *turned)
        )

    def key_of_light(self, mean: Float) -> str:
        """The same, by the light that came out in place of what it was made from."""
        parts = [mean[r.row0 : r.row1, r.col0 : r.col1] for r in self.setup.regions] or [mean]
        return content_hash((parts, self._rest))

    @property
    def pixels(self) -> int:
        """Of one frame."""
        shot, sensor = self.setup.shot, self.model.sensor
        rows, cols = (shot.window or (0, 0, sensor.rows, sensor.cols))[2:]
        return rows * cols


_MEASURED = Remembered(WORKER_BYTES)


def vectors_of(tasks: Sequence[ShotPart], rows: Mapping[str, Rows]) -> list[Float]:
    """Values of rows, by shot, for some tasks; equal light and electronics are shot once per process, equal frames measured once.

    Unlike the store, which knows what a shot is made from, this one knows what came out: a parameter that does not touch
    the shot costs nothing but the light or, of the electronics, the frames.
    """
    keys = [(rows[task.of].digest, task.key_of_light(mean_electrons(task.model, task.setup))) for task in tasks]
    known = {key: found for key in keys if (found := _MEASURED.get(key)) is not None}
    todo = {key: task for key, task in zip(keys, tasks, strict=True) if key not in known}
    for key, vector in zip(todo, _of_frames(list(todo.values()), rows), strict=True):
        known[key] = vector
        _MEASURED.put(key, vector)
    return [known[key] for key in keys]


def _of_frames(tasks: Sequence[ShotPart], rows: Mapping[str, Rows]) -> Iterator[Float]:
    """Values of rows for some tasks; of a demo's flats and darks a quarter are another's by the bit."""
    for part, captures in _shot_together(tasks):
        marks = [
            content_hash((rows[t.of].digest, t.setup.shot.name, t.chosen, t.model.sensor, [c.mosaic for c in own]))
            for t, own in zip(part, captures, strict=True)
        ]
        known = {mark: found for mark in marks if (found := _MEASURED.get(mark)) is not None}
        todo = {mark: (task, own) for mark, task, own in zip(marks, part, captures, strict=True) if mark not in known}
        measured = measure_across([(task.setup.shot, own, task.choices) for task, own in todo.values()])
        for (mark, (task, _)), blocks in zip(todo.items(), measured, strict=True):
            known[mark] = rows[task.of].values(blocks)
            _MEASURED.put(mark, known[mark])
        yield from (known[mark] for mark in marks)


@dataclass(frozen=True, eq=False)
class Sampled:
    """What replicas of one shot show of n rows.

    ``values`` is (replicas, n); ``covariance`` (n, n) the stated one, mean over the first ``covered`` of them, without the
    random numbers that other shots share: ``shared`` holds their loadings, (covered, n) by the number of their label.
    """

    values: Float
    covariance: Float
    shared: Mapping[int, Float]

    def only(self, rows: NDArray[np.intp]) -> Sampled:
        """Of some of the rows."""
        shared = {label: part[:, rows] for label, part in self.shared.items()}
        return Sampled(self.values[:, rows], self.covariance[np.ix_(rows, rows)], shared)

    def packed(self) -> Float:
        """All of it as one vector, for stores."""
        covered = len(next(iter(self.shared.values()))) if self.shared else 0
        head = [*self.values.shape, len(self.shared), covered, *self.shared]
        loadings = [part.ravel() for part in self.shared.values()]
        return np.concatenate([np.array(head, float), self.values.ravel(), self.covariance.ravel(), *loadings])

    @classmethod
    def unpacked(cls, vector: Float) -> Sampled:
        """From `packed`."""
        replicas, n, labels, covered = (int(v) for v in vector[:4])
        names, rest = [int(v) for v in vector[4 : 4 + labels]], vector[4 + labels :]
        values, rest = rest[: replicas * n].reshape(replicas, n), rest[replicas * n :]
        covariance, rest = rest[: n * n].reshape(n, n), rest[n * n :]
        loadings = rest.reshape(labels, covered, n)
        return cls(values, covariance, dict(zip(names, loadings, strict=True)))


def sample_of(tasks: Sequence[ShotPart], rows: Rows, covered: int) -> Float:
    """`Sampled` of replicas of one shot, packed; covariance from the first ``covered`` tasks."""
    every = blocks_of(tasks)
    n = len(rows.keys)
    covariance = np.zeros((n, n))
    shared: dict[int, Float] = {}
    for i, blocks in enumerate(every[:covered]):
        order = rows.order(blocks)
        own = MetricTable(tuple(replace(block, shared={}) for block in blocks)).covariance()
        covariance += _ordered(own, order) / covered
        table = MetricTable(tuple(blocks))
        labels = sorted({label for block in blocks for label in block.shared})
        for label, column in zip(labels, table.shared_columns().T, strict=True):
            number = int(content_hash(label)[:LABEL_DIGITS], 16)
            shared.setdefault(number, np.zeros((covered, n)))[i] = np.where(order < 0, 0.0, column[order])
    return Sampled(np.array([rows.values(blocks) for blocks in every]), covariance, shared).packed()


def _ordered(covariance: Float, order: NDArray[np.intp]) -> Float:
    if not covariance.size:
        return np.full((order.size, order.size), np.nan)
    out = covariance[np.ix_(order, order)]
    out[order < 0] = np.nan
    out[:, order < 0] = np.nan
    return np.asarray(out)


def render_part(tasks: Sequence[ShotPart], rows: Rows) -> Float | None:
    """Covariance of rows from the noise of a shot's render; None without one."""
    (task,) = tasks
    one = replace(task.setup, shot=replace(task.setup.shot, frames=1))

    def measure(captures: Sequence[Capture]) -> Float:
        try:
            return rows.values([block for _, block in measure_shot(one.shot, captures, choices=task.choices)])
        except InputError:
            return rows.values([])

    return render_covariance(task.model, one, measure)


def blocks_of(tasks: Sequence[ShotPart]) -> list[list[Block]]:
    """The blocks of tasks; none where nothing of one can be measured."""
    return [
        blocks
        for part, captures in _shot_together(tasks)
        for blocks in measure_across([(t.setup.shot, own, t.choices) for t, own in zip(part, captures, strict=True)])
    ]


def _shot_together(tasks: Sequence[ShotPart]) -> Iterator[tuple[Sequence[ShotPart], list[tuple[Capture, ...]]]]:
    """Tasks with their frames, as many at a time as are held."""
    step = max(1, HELD_PIXELS // max(task.pixels * task.setup.shot.frames for task in tasks)) if tasks else 1
    for i in range(0, len(tasks), step):
        part = tasks[i : i + step]
        yield part, [_frames_of(task) for task in part]


def _frames_of(task: ShotPart) -> tuple[Capture, ...]:
    return shoot(
        task.model,
        task.setup,
        task.seed,
        mode=task.mode,
        choices=task.choices,
        rounded=task.rounded,
        mirrored=task.mirrored,
        flicker=task.flicker,
    )
