"""A plan shot by many processes or machines: each shot in a hidden folder beside the campaign, which appears when all are there.

The hidden folder is named after what is shot (model, plan, seed, code): the same command goes on where it was, and parts
of one simulation (``--shard``) on one disk find each other's shots.  A shot's folder is renamed into its place when it is whole.
A rendered shot is taken here, and the passes of its renders go to the workers.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from isetval.app.batch.run import Progress
from isetval.camera.model import CameraModel
from isetval.camera.shooting import shoot_one, shot_setup
from isetval.core.cache import code_hash, content_hash
from isetval.core.campaign import Campaign
from isetval.core.engine import Engine, Here, Lost, run_works
from isetval.core.errors import InputError
from isetval.core.scene import RenderedTarget
from isetval.core.threads import one_blas_thread
from isetval.files.campaign_writer import check_free, shot_stems, write_frames, write_tables
from isetval.scenes.rendered.rendering import passes_on


class Shots(Protocol):
    """Shots of a plan that any process can take by number; it can be pickled."""

    @property
    def names(self) -> Sequence[str]:
        """Of the shots."""
        ...

    def key(self) -> str:
        """Of all that decides the bits, the code included."""
        ...

    def is_rendered(self, number: int) -> bool:
        """Whether a shot's work is a render, whose passes are taken by workers."""
        ...

    def take(self, folder: Path, number: int) -> None:
        """Write the frames of a shot into an empty folder, in order of name, under names that no other shot has."""
        ...

    def finish(self, folder: Path, files: Mapping[str, tuple[str, ...]]) -> None:
        """Write what stands beside the frames of all shots (file names by shot)."""
        ...


@dataclass(frozen=True, eq=False)
class Shooting:
    """A simulation: ``campaign`` is the plan as it is written, with the simulation's provenance and without captures."""

    model: CameraModel
    plan: Campaign
    campaign: Campaign
    seed: int = 0
    values: Mapping[str, float] | None = None
    draw: bool = False
    sensor_seed: int | None = None

    def key(self) -> str:
        """Of all that decides the bits, the code included."""
        setups = [shot_setup(self.plan, shot, self.values or {}).digest() for shot in self.plan.shots]
        names = [(shot.name, shot.frames) for shot in self.plan.shots]
        options = (self.seed, dict(self.values or {}), self.draw, self.sensor_seed)
        return content_hash((self.model.digest(), setups, names, self.plan.nuisances, self.plan.sensor, options, code_hash()))

    @property
    def names(self) -> Sequence[str]:
        """Of the shots."""
        return [shot.name for shot in self.plan.shots]

    def is_rendered(self, number: int) -> bool:
        """Whether a shot shows a scene that is rendered."""
        return isinstance(self.plan.shots[number].target, RenderedTarget)

    def take(self, folder: Path, number: int) -> None:
        """Write the frames of a shot into a folder."""
        frames = shoot_one(
            self.model, self.plan, number, self.seed, values=self.values, draw=self.draw, sensor_seed=self.sensor_seed
        )
        stem = shot_stems(self.plan.shots)[self.plan.shots[number].name]
        write_frames(folder, self.campaign, frames, stem=stem, model=self.model)

    def finish(self, folder: Path, files: Mapping[str, tuple[str, ...]]) -> None:
        """Write the campaign's tables beside its frames."""
        write_tables(self.campaign, folder, dict(files), ())


@one_blas_thread()
def shoot_works(job: Shots, folder: str, numbers: Sequence[int]) -> int:
    """Shoot and write shots by number; how many were not there yet."""
    made = 0
    for number in numbers:
        place = _place(Path(folder), number)
        if place.is_dir():
            continue
        own = Path(tempfile.mkdtemp(dir=folder, prefix=".shot"))
        try:
            job.take(own, number)
            _rename(own, place)
        finally:
            shutil.rmtree(own, ignore_errors=True)
        made += 1
    return made


def _place(folder: Path, number: int) -> Path:
    return folder / f"shot_{number:05d}"


def _rename(own: Path, place: Path) -> None:
    """Give a whole folder its name, unless another run was there first with the same content."""
    try:
        os.replace(own, place)
    except OSError:
        if not place.is_dir():
            raise


def hidden_folder(job: Shots, target: Path) -> Path:
    """Where shots are kept until the last one is there."""
    return target.resolve().parent / f".{target.name}.{job.key()[:16]}"


def shoot_on(
    job: Shots, engine: Engine, target: Path, *, part: tuple[int, int] | None = None, progress: Progress | None = None
) -> tuple[int, int]:
    """Shoot a plan, or the i-th of n parts of its shots, on an engine.

    Parameters
    ----------
    job : Shots
    engine : Engine
    target : Path
        Becomes the campaign's folder when the last shot is there, in whatever run that is.
    part : (i, n), optional
    progress : callable, optional

    Returns
    -------
    done, shots : int
        Shots that are written, and those of the plan; equal numbers: ``target`` is there.

    Raises
    ------
    InputError
        If ``target`` is in use, cannot be written, or the workers end again and again.
    """
    check_free(target)
    folder = hidden_folder(job, target)
    shots = range(len(job.names))
    own = shots if part is None else shots[part[0] - 1 :: part[1]]
    try:
        folder.mkdir(exist_ok=True)
        todo = [number for number in own if not _place(folder, number).is_dir()]
        done = len(own) - len(todo)
        rendered = [[number] for number in todo if job.is_rendered(number)]
        others = [[number] for number in todo if not job.is_rendered(number)]
        for works, engines in ((rendered, (Here(), engine)), (others, (engine, Here()))):
            with passes_on(engines[1]):
                for items, result in run_works(partial(shoot_works, job, str(folder)), works, engines[0]):
                    if isinstance(result, Lost):
                        raise InputError(f"shot {job.names[items[0]]}: {result.words.replace('read', 'shot')}")
                    done += len(items)
                    if progress is not None:
                        progress(f"shooting {job.names[items[0]]}", done, len(own))
        there = [number for number in shots if _place(folder, number).is_dir()]
        if len(there) == len(shots):
            _assemble(job, folder, target)
    except OSError as error:
        raise InputError(
            f"{target}: cannot be written ({error.strerror}); what was shot is kept: make room or choose another folder"
        ) from None
    return len(there), len(shots)


def _assemble(job: Shots, folder: Path, target: Path) -> None:
    """The campaign's folder from those of its shots, renamed into its place; they go when it is there.

    It is made among them, so that what a killed run leaves of it goes with them.
    """
    scratch = Path(tempfile.mkdtemp(dir=folder, prefix=".whole"))
    scratch.chmod(0o755)
    try:
        files: dict[str, tuple[str, ...]] = {}
        for number, name in enumerate(job.names):
            frames = sorted(_place(folder, number).iterdir())
            for frame in frames:
                _linked(frame, scratch / frame.name)
            files[name] = tuple(frame.name for frame in frames)
        job.finish(scratch, files)
        if target.is_dir():
            target.rmdir()
        os.replace(scratch, target)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    shutil.rmtree(folder, ignore_errors=True)


def _linked(file: Path, target: Path) -> None:
    """The same file under another name, or a copy where the disk has no links."""
    try:
        os.link(file, target)
    except OSError:
        shutil.copyfile(file, target)


def shooting(model: CameraModel, plan: Campaign, made: Mapping[str, Any], **options: Any) -> Shooting:
    """A simulation of a plan with its provenance ``made``; what somebody measured is not simulated."""
    shots = tuple(replace(shot, given=None) for shot in plan.shots)
    bare = replace(plan.as_plan(), shots=shots)
    return Shooting(model, bare, replace(bare, sensor=model.sensor, provenance=dict(made)), **options)
