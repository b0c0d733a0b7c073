"""What a model predicts for the metrics of a campaign: its plan shot and measured by the same estimators.

The prediction is the mean of several simulated campaigns at the nominal model, plus the difference that
other parameters make with common random numbers (the same streams on both sides).  Only shots whose
light or electronics a parameter changes are simulated again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from isetval.camera.chain import ShotSetup
from isetval.camera.model import CameraModel
from isetval.camera.shooting import after_shot_before, cameras_of, shot_setup
from isetval.core.cache import content_hash
from isetval.core.campaign import Campaign, Shot
from isetval.core.context import Mode
from isetval.core.metric import MetricTable
from isetval.core.number_store import NumberStore
from isetval.core.scene import RenderedTarget
from isetval.core.sensor import Roi
from isetval.loop.base import Base, averaged, gathered, scattered
from isetval.loop.block_factor import of_blocks, scaled
from isetval.loop.difference_frames import DifferenceFrames, Way
from isetval.loop.frame_light import stated_flicker
from isetval.loop.given_side import in_large_pixels, is_noisy, measured_only, with_stated_covariance, with_systematic
from isetval.loop.looked_at import looked_at
from isetval.loop.shot_groups import by_shot, for_differences, joint_differences, of_one_picture
from isetval.loop.shot_task import Halves, Rows, Sampled, ShotPart, render_part, sample_of, vectors_of
from isetval.loop.stand_ins import of_shot, renamed, stand_ins
from isetval.loop.task_runner import Call, Runner
from isetval.loop.telling import Counted
from isetval.measure.analyses.flat_fields import FRAME_SCATTER
from isetval.measure.works import Work

Float = NDArray[np.float64]
REPLICAS = 16  # the mean of so many adds 1/16 to the variance of a difference, 3 % to its sigma
COVARIANCE_REPLICAS = 4  # stated covariances scatter little; the scatter of all replicas scales them
DERIVATIVE_SEEDS = (101,)  # common random numbers: one draw tells a difference to the second order
# signatures have seeds of their own: what rounding does to a fit must not look like a signature
SIGNATURE_SEEDS = (201,)
RANDOM_SEEDS = (201, 202)
# a specimen's pattern (hot pixels, columns) is one draw: its expectation needs many; a shot takes as many as its blocks say
SPECIMEN_SEEDS = tuple(range(101, 113))
# noise turns some of the pixels to another code: 1.3 sigmas of all rows in one draw of both signs, .6 in four
NOISE_SEEDS = SPECIMEN_SEEDS[:4]
BASE_SEED = 7_000  # replicas have seeds that neither captures nor differences use
Place = tuple[CameraModel, Halves, Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class Point:
    """Where a prediction is made: a model and values of the nuisances."""

    model: CameraModel
    values: Mapping[str, float] = field(default_factory=dict)


class Predictor:
    """Predicts the rows of a measured table for any point; remembers every simulated shot.

    Parameters
    ----------
    plan : Campaign
        Its captures are not used.
    table : MetricTable
        The measured rows: predictions come in their order, made with their choices.
    usual : names, optional
        Of effects that every point has (default: all).  Noise of others is drawn with both signs (`Context`).
    rows : mapping, optional
        Keys of the rows that the plan gives, by shot (`isetval.loop.nominal`): what is simulated is kept for all of them,
        so that campaigns of one plan share it whichever rows each of them has.
    jobs : int
        Worker processes; 1 computes in this process.
    progress : callable, optional
        ``progress(done, total)``, called as shots are simulated: how many of those that are asked for together and were
        not known.  The time left follows from both; see `isetval.loop.telling.Teller` for the words that belong to it.
    """

    def __init__(
        self,
        plan: Campaign,
        table: MetricTable,
        *,
        usual: Collection[str] | None = None,
        rows: Mapping[str, Sequence[Any]] | None = None,
        jobs: int = 1,
        progress: Counted | None = None,
    ) -> None:
        self.plan = plan.as_plan()
        self.table = table
        self.usual = None if usual is None else frozenset(usual)
        self.keys = [m.key() for m in table.metrics]
        given = {shot.name for shot in self.plan.shots if shot.given is not None}
        self.place = {key: i for i, key in enumerate(self.keys)}
        by_shot: dict[str, list[int]] = {}
        for i, m in enumerate(table.metrics):
            by_shot.setdefault(m.shot, []).append(i)
        self.shots = tuple(shot for shot in self.plan.shots if shot.name in by_shot)
        self.rows = {shot.name: np.array(by_shot[shot.name]) for shot in self.shots}
        self._simulated = stand_ins(self.plan)
        own_keys = {name: self._keys_of(name, [self.keys[i] for i in own]) for name, own in self.rows.items()}
        plan_keys = {name: self._keys_of(name, (rows or {}).get(name, ())) for name in own_keys}
        self._wanted = {name: Rows.of(list(dict.fromkeys([*plan_keys[name], *own]))) for name, own in own_keys.items()}
        self.pick = {name: self._wanted[name].places(own) for name, own in own_keys.items()}
        self._scatters = np.array([m.name == FRAME_SCATTER and m.shot not in given for m in table.metrics], bool)
        self._number = of_one_picture(self.shots)
        self.differences = {shot.name: joint_differences(table, shot.name) for shot in self.shots}
        self._choices = {s.name: of_shot(table.choices, s.name, self._simulated[s.name].name) for s in self.shots}
        self._chosen = {name: content_hash(choices) for name, choices in self._choices.items()}
        self._frames = DifferenceFrames.of(table)
        self._through = {s.name: for_differences(self._simulated[s.name], self._choices[s.name]) for s in self.shots}
        self._regions: dict[str, tuple[Roi, ...]] = {}
        self._memo = NumberStore.shared(repr(sorted({self._simulated[shot.name].name for shot in self.shots})))
        self._runner = Runner(jobs, progress)

    @property
    def jobs(self) -> int:
        """Worker processes."""
        return self._runner.jobs

    def of_plan(self, plan: Campaign) -> Predictor:
        """The same rows of another plan with the same shots (in another light); workers and what is known are shared."""
        other = object.__new__(Predictor)
        other.__dict__.update(self.__dict__, plan=plan.as_plan())
        other.shots = tuple(shot for shot in plan.shots if shot.name in self.rows)
        other._simulated = {shot.name: replace(shot, name=self._simulated[shot.name].name) for shot in plan.shots}
        return other

    def only(self, names: Collection[str]) -> Predictor:
        """The same rows, of which those of the named shots alone are predicted; workers and what is known are shared."""
        if all(shot.name in names for shot in self.shots):
            return self
        other = object.__new__(Predictor)
        other.__dict__.update(self.__dict__, shots=tuple(shot for shot in self.shots if shot.name in names))
        return other

    def that_feel(self, labels: Collection[str]) -> Predictor:
        """The shots alone that some of these nuisances act on, or on the shot before; all for one of the camera or given rows."""
        acting = {shot.name: {label for _, label in self.plan.nuisances_of(shot)} for shot in self.plan.shots}
        if not set(labels) <= set().union(*acting.values()):
            return self
        felt = {name for name, own in acting.items() if own & set(labels)}
        before = {shot.name: self.plan.before(shot) for shot in self.shots}
        return self.only(felt | {name for name, other in before.items() if other is not None and other.name in felt})

    @property
    def predicted(self) -> NDArray[np.bool_]:
        """Which of the rows are predicted, (metrics,)."""
        out = np.zeros(len(self.keys), bool)
        out[np.concatenate([self.rows[shot.name] for shot in self.shots])] = True
        return out

    @property
    def noise_free(self) -> NDArray[np.bool_]:
        """Of which rows differences are taken between frames without noise, (metrics,); rows of several shots have none."""
        shots = {name for name, how in self.differences.items() if how.noise_free}
        return np.array([m.shot in shots for m in self.table.metrics], bool)

    def over_workers(self, calls: Sequence[Call]) -> Iterator[tuple[int, Any]]:
        """Places of calls and what they gave, done by the workers of this predictor."""
        return self._runner.results(calls)

    def in_turn(self, works: Iterable[Work]) -> Iterator[Any]:
        """What functions give for their arguments, in their order, by workers that have begun (`isetval.loop.task_runner`)."""
        return self._runner.in_turn(works)

    def close(self) -> None:
        """Stop the workers; keep what was simulated for the next time."""
        self._memo.save()
        self._runner.close()

    def _keys_of(self, name: str, keys: Sequence[Any]) -> list[tuple[Any, ...]]:
        """Keys of the rows of a shot, as the one that is simulated in its place has them."""
        return [renamed(key, self._simulated[name].name) for key in keys]

    def parts(self, point: Point, seed: int, *, derivative: bool) -> list[ShotPart]:
        """The shots of a point, each with its choices."""
        cameras, setups = cameras_of(point.model, self.plan, point.values), self._set_up(point, derivative)
        each = {id(camera): camera for camera in cameras.values()}  # many shots have the same one
        halves = {place: Halves.of(camera) for place, camera in each.items()}
        places = {name: (camera, halves[id(camera)], point.values) for name, camera in cameras.items()}
        return [self._part(places[shot.name], shot, setups[shot.name], seed, derivative) for shot in self.shots]

    def _set_up(self, point: Point, derivative: bool) -> dict[str, ShotSetup]:
        """Every shot by name as the values of nuisances set it up, with the regions that are looked at."""
        made = {shot.name: shot_setup(self.plan, shot, point.values) for shot in self.shots}
        return {name: self._as_asked(setup, point.model, derivative) for name, setup in made.items()}

    def _as_asked(self, setup: ShotSetup, camera: CameraModel, derivative: bool) -> ShotSetup:
        shot = setup.shot
        setup = replace(setup, shot=self._simulated[shot.name])
        if derivative and self.differences[shot.name].one_frame:
            setup = setup.of_one_frame()
        if shot.name not in self._regions:
            self._regions[shot.name] = looked_at(shot, camera.sensor)
        return replace(setup, regions=self._regions[shot.name]) if self._regions[shot.name] else setup

    def _part(
        self,
        place: Place,
        shot: Shot,
        setup: ShotSetup,
        seed: int,
        derivative: bool,
        mirrored: frozenset[str] = frozenset(),
        rounded: bool = True,
    ) -> ShotPart:
        camera, halves, values = place
        how = self.differences[shot.name]
        if derivative and how.noise_free and shot.given is None:
            camera, halves = self._frames.without_patterns(camera)
            mirrored, seed = frozenset(), 0
        setup = after_shot_before(setup, camera, self.plan, values, shot)
        mean_only = how.noise_free or shot.levels_only  # a resampled picture's noise is not its sensor's
        mode: Mode = "capture" if not derivative else "expected" if mean_only else "derivative"
        choices, chosen = self._through[shot.name] if derivative else (self._choices[shot.name], self._chosen[shot.name])
        if shot.given is not None:
            choices = with_systematic(choices, self.plan, shot, values)
            chosen = content_hash(choices)
            large, setup = in_large_pixels(camera, setup, choices)
            camera, halves = (camera, halves) if large is camera else (large, Halves.of(large))
        if mode == "expected":
            rounded = not how.noise_free or shot.given is not None
        seed = seed if is_noisy(shot, choices) else 0
        flicker = stated_flicker(self.plan, shot)
        return ShotPart(camera, setup, seed, mode, choices, halves, chosen, shot.name, rounded, mirrored, flicker)

    def derivative_vectors(
        self,
        points: Sequence[Point],
        seeds: Sequence[int] = DERIVATIVE_SEEDS,
        *,
        of_noise: bool = False,
        only: Collection[str] | None = None,
    ) -> list[Float]:
        """Metrics (metrics,) at each point, mean over ``seeds`` of common random numbers.

        Of ``seeds`` each shot uses as many as the `Differences` of its blocks say.  With ``of_noise`` only shots in which
        noise itself is measured are simulated (means elsewhere do not feel it), and of those ``only`` the named ones; the rows
        of the others are nan.

        Noise that a nominal model does not have is drawn with both signs: what is linear in a weak one, and so in its means
        and with all other noise, would outweigh its variance (row noise of .026 DN was 5.4 sigmas long and 7.2 in one draw).
        """
        shots = [shot for shot in self.shots if not (of_noise and self.differences[shot.name].one_frame)]
        shots = [shot for shot in shots if only is None or shot.name in only]
        cameras = [cameras_of(point.model, self.plan, point.values) for point in points]
        signs = [self._signs(point.model) for point in points]
        seeded = [(shot, seed) for shot in shots for seed in self._draws(shot, seeds)]
        draws = [[(shot, seed, sign) for shot, seed in seeded for sign in own] for own in signs]
        # most points share their values: what these set up is made and hashed once
        places = {id(point.values): point for point in points}
        setups = {key: self._set_up(point, True) for key, point in places.items()}
        ways = [self._ways(own, shots) for own in cameras]
        tasks = [
            self._part(
                (way.camera, way.halves, point.values), shot, setups[id(point.values)][shot.name], seed, True, sign, way.rounded
            )
            for point, own, how in zip(points, draws, ways, strict=True)
            for shot, seed, sign in own
            for way in how[shot.name]
        ]
        results = iter(self._vectors(tasks))
        out = []
        for own, how in zip(draws, ways, strict=True):
            count = Counter(shot.name for shot, *_ in own)
            total = np.full(len(self.keys), np.nan)
            for shot in shots:
                total[self.rows[shot.name]] = 0.0
            for shot, *_ in own:
                for way in how[shot.name]:
                    total[self.rows[shot.name]] += way.share * next(results) / count[shot.name]
            total[self._scatters] = np.cbrt(total[self._scatters])
            out.append(total)
        return out

    def _draws(self, shot: Shot, seeds: Sequence[int]) -> Sequence[int]:
        """Seeds that a difference of a shot is the mean over: in place of one, several of darks of a camera with tolerances.

        Codes of darks turn one by one: where noise is a third of a code, what a dark current off by its tolerance makes of
        row noise and rises was noise in one draw, and told as something unknown.
        """
        draws = self.differences[shot.name].draws
        several = shot.role == "dark" and tuple(seeds) == DERIVATIVE_SEEDS and self.plan.tolerances_of(shot)
        return (NOISE_SEEDS if several else seeds)[:draws]

    def _ways(self, cameras: Mapping[str, CameraModel], shots: Sequence[Shot]) -> dict[str, list[Way]]:
        """How a difference of each shot is taken, by name, each with its own camera."""
        sharing: dict[int, list[Shot]] = {}
        for shot in shots:
            sharing.setdefault(id(cameras[shot.name]), []).append(shot)
        out: dict[str, list[Way]] = {}
        for own in sharing.values():
            out |= self._frames.ways(cameras[own[0].name], own)
        return out

    def _signs(self, camera: CameraModel) -> list[frozenset[str]]:
        """Which effects of a camera draw with the other sign, draw by draw: none, and those whose noise is not usual."""
        usual = {e.name for e in camera.effects} if self.usual is None else self.usual
        unusual = frozenset(e.name for e in camera.effects if e.draws_normals and e.name not in usual)
        return [frozenset(), unusual] if unusual else [unusual]

    def small_shots(self, point: Point) -> frozenset[str]:
        """Names of the shots that have no more pixels than the mean shot, none if all are alike.

        A chart costs ten times as much as a flat.
        """
        pixels = {part.of: part.pixels for part in self.parts(point, 0, derivative=True)}
        small = frozenset(name for name, n in pixels.items() if n <= np.mean(list(pixels.values())))
        return small if len(small) < len(pixels) else frozenset()

    def base(self, point: Point, replicas: int = REPLICAS, *, darks: int = 0, known: Mapping[str, Sampled] | None = None) -> Base:
        """Mean, covariance and scatter of ``replicas`` simulated campaigns, each with its own specimen; some may be ``known``.

        Of dark shots there are ``darks`` where that is more: means and what error bars are scaled by are those of all of them.
        """
        every = [self.parts(point, BASE_SEED + r, derivative=False) for r in range(replicas)]
        further = self.only({shot.name for shot in self.shots if shot.role == "dark" and shot.given is None})
        more = [further.parts(point, BASE_SEED + r, derivative=False) for r in range(replicas, darks)] if further.shots else []
        count = min(COVARIANCE_REPLICAS, replicas)
        samples = dict(known or {})
        groups = [[parts[k] for parts in every] for k, shot in enumerate(self.shots) if shot.name not in samples]
        place = {shot.name: k for k, shot in enumerate(further.shots)}
        for group in groups if more else ():
            if (name := group[0].of) in place:
                group += [parts[place[name]] for parts in more]
        for group, vector in zip(groups, self.known_or_made(sample_of, groups, [(count,)] * len(groups)), strict=True):
            name = group[0].of
            samples[name] = Sampled.unpacked(vector).only(self.pick[name])
        placed = [(self.rows[shot.name], samples[shot.name]) for shot in self.shots]
        values, covariance = gathered(placed, replicas, len(self.keys))
        scale = scattered(placed, measured_only(covariance, self.table), self.table.metrics)
        rendered = of_blocks(list(self._of_renders(every[0])), len(self.keys))
        covariance = csr_array(scaled(covariance, lambda row, column: scale[row] * scale[column]) + rendered)
        covariance = with_stated_covariance(covariance, self.table, replicas)
        mean, number = averaged(placed, len(self.keys))
        return Base(mean, covariance, values, scale, rendered.diagonal(), samples, number - replicas)

    def _of_renders(self, tasks: list[ShotPart]) -> Iterator[tuple[NDArray[np.intp], Float]]:
        """Rows (n,) of shots and their covariance (n, n) from the noise of renders, which replicas share and do not show."""
        rendered = [task for task in tasks if isinstance(task.setup.shot.target, RenderedTarget)]
        calls = [self._call(render_part, [task]) for task in rendered]
        for i, part in self._runner.results(calls):
            name = rendered[i].of
            if part is not None:
                yield self.rows[name], part[np.ix_(self.pick[name], self.pick[name])]

    def _call(self, function: Any, tasks: Sequence[ShotPart], *more: Any) -> Call:
        shot = tasks[0].of
        return Call(function, (tasks, self._wanted[shot], *more), self._number[shot], len(tasks))

    def _vectors(self, tasks: list[ShotPart]) -> list[Float]:
        """Measured values of each task; equal content is simulated once."""
        keys = [self._key(task) for task in tasks]
        missing = {key: task for key, task in zip(keys, tasks, strict=True) if self._memo.get(key) is None}
        groups = list(by_shot(missing))
        asked = [[missing[key] for key in group] for group in groups]
        wanted = [{task.of: self._wanted[task.of] for task in own} for own in asked]
        calls = [
            Call(vectors_of, (own, rows), self._number[own[0].of], len(own)) for own, rows in zip(asked, wanted, strict=True)
        ]
        for i, vectors in self._runner.results(calls):
            for key, vector in zip(groups[i], vectors, strict=True):
                self._memo.put(key, vector)
        return [self._memo.items[key][self.pick[task.of]] for key, task in zip(keys, tasks, strict=True)]

    def _key(self, task: ShotPart) -> str:
        return task.key + self._wanted[task.of].digest

    def known_or_made(self, function: Any, groups: Sequence[Sequence[ShotPart]], more: Sequence[tuple[Any, ...]]) -> list[Float]:
        """What ``function(tasks, rows, *more)`` gives for groups of tasks of one shot, from the store where it is known."""
        keys = [
            content_hash((function.__name__, [self._key(task) for task in group], extra))
            for group, extra in zip(groups, more, strict=True)
        ]
        missing = list({key: i for i, key in enumerate(keys) if self._memo.get(key) is None}.values())
        for i, vector in self._runner.results([self._call(function, groups[i], *more[i]) for i in missing]):
            self._memo.put(keys[missing[i]], vector)
        return [self._memo.items[key] for key in keys]
