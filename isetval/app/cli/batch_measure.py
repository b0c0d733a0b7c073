"""``isetval measure`` on many files: processes or a cluster, a store that makes every run resumable, shards."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isetval.app.cli.console import Console
from isetval.app.cli.outcome import BAD_INPUT, FINE, MEASURED_SUFFIXES, Outcome

if TYPE_CHECKING:
    from isetval.app.batch.run import Batch
    from isetval.core.engine import Cluster, Engine

MOST_NAMED = 50  # files left out that are named on the screen; all of them stand in the result


def add_batch_options(parser: argparse.ArgumentParser) -> None:
    """Options for many files."""
    many = parser.add_argument_group(
        "many files",
        "With one of these each file (darks and flats: the files of each folder) is measured by itself, with its own black "
        "level, and what was measured is stored: after any interruption the same command goes on where it was.",
    )
    add_engine_options(many)
    many.add_argument("--store", metavar="DIR", type=Path, help="where records are kept, by content (default: the user's cache)")
    many.add_argument(
        "--isolate", action="store_true", help="decode in a process of its own: a file that ends it is left out by name"
    )


def add_engine_options(group: argparse._ArgumentGroup) -> None:
    """What does the work: processes of this machine or a cluster."""
    group.add_argument("-j", "--jobs", type=int, metavar="N", help="N processes of this machine")
    add_cluster_options(group)


def add_cluster_options(group: argparse._ActionsContainer) -> None:
    """A cluster in place of processes of this machine."""
    group.add_argument("--scheduler", metavar="ADDRESS", help="a dask scheduler, as tcp://host:8786 (extra 'cluster')")
    group.add_argument("--scheduler-file", metavar="FILE", help="the JSON file of a dask scheduler (extra 'cluster')")


def has_engine(args: argparse.Namespace) -> bool:
    """Whether one of them is named."""
    return args.jobs is not None or bool(args.scheduler or args.scheduler_file)


def is_batch(args: argparse.Namespace) -> bool:
    """Whether any of the options is given."""
    return has_engine(args) or args.isolate or args.store is not None


def measure_batch(args: argparse.Namespace, console: Console, raw: Mapping[str, Any] | None) -> Outcome:
    """Measure files as units of work; the result has the form of every other measurement."""
    from isetval.app.batch.run import run_batch
    from isetval.app.batch.units import Settings, part_of, units_of
    from isetval.files.loose_files import Asked, levels_are_said, raw_files

    _refuse_pages(args)
    _refuse_campaigns(args)
    settings = Settings(Asked(args.role, args.method, args.channel, args.roi, args.gain_dn_per_e), args.black or "auto", raw)
    units = part_of(units_of(raw_files(args.paths, said=levels_are_said(raw)), args.role), args.shard)
    fresh = getattr(args, "fresh", False)  # of rerun: no store may answer for it
    store = None if fresh else args.store or _own_store()
    with engine_for(args) as engine:
        console.say(f"measuring {sum(len(unit.files) for unit in units)} files")
        try:
            batch = run_batch(
                units,
                settings,
                engine,
                store_folder=store,
                must_store=args.store is not None,
                progress=console.progress,
            )
        except KeyboardInterrupt:
            if store is not None:
                console.note(f"what was measured is kept in {store}: the same command goes on from there")
            raise
    whole = args.output is not None or args.json or args.limits is not None or fresh
    return _outcome(batch, settings.table(), whole=whole)


def _refuse_pages(args: argparse.Namespace) -> None:
    from isetval.core.errors import InputError

    if args.curves or (args.output is not None and Path(args.output).suffix.lower() in MEASURED_SUFFIXES):
        raise InputError(
            "pictures and curves are not made of many files at once; write .json or .csv here, "
            "and measure the few files of interest without --jobs, --scheduler, --store and --isolate"
        )


def _refuse_campaigns(args: argparse.Namespace) -> None:
    """A campaign without a role given is measured as a whole: its shots share their sessions."""
    from isetval.core.errors import InputError

    campaigns = [path for path in args.paths if path.suffix.lower() == ".toml" or (path / "campaign.toml").is_file()]
    if campaigns and args.role is None:
        raise InputError(
            f"{campaigns[0]}: is a campaign, which is measured as a whole; leave out --jobs, --scheduler, --store and --isolate, "
            "or add --role to measure its files without their campaign"
        )


def _own_store() -> Path | None:
    """The folder of records in the user's cache; None where there shall be no cache."""
    import os

    from isetval.core.cache import cache_folder

    folder = cache_folder() / "measured"
    return None if folder.is_relative_to(os.devnull) else folder


def cluster_of(args: argparse.Namespace) -> Cluster | None:
    """The cluster that the options name, None where they name none; two are refused."""
    from isetval.core.engine import Cluster
    from isetval.core.errors import InputError

    if args.scheduler and args.scheduler_file:
        raise InputError("--scheduler and --scheduler-file are different engines; name one of them")
    named = args.scheduler or args.scheduler_file
    return Cluster(args.scheduler or "", file=args.scheduler_file or "") if named else None


@contextmanager
def engine_for(args: argparse.Namespace) -> Iterator[Engine]:
    """The engine that the options name (`engine_of`), left when the block ends; what runs is waited for where it ended well."""
    engine, finished = engine_of(args), False
    try:
        yield engine
        finished = True
    finally:
        engine.close(wait=finished)


def engine_of(args: argparse.Namespace) -> Engine:
    """The engine that the options name; this process where they name none.

    Raises
    ------
    InputError
        If they name two.
    """
    from isetval.core.engine import Here, Processes
    from isetval.core.errors import InputError

    isolate = getattr(args, "isolate", False)
    if sum(map(bool, (args.jobs is not None or isolate, args.scheduler, args.scheduler_file))) > 1:
        own = "--jobs or --isolate" if hasattr(args, "isolate") else "--jobs"
        raise InputError(f"{own}, --scheduler and --scheduler-file are different engines; name one of them")
    if (cluster := cluster_of(args)) is not None:
        return cluster
    return Here() if args.jobs is None and not isolate else Processes(1 if args.jobs is None else args.jobs)


def _outcome(batch: Batch, settings: Mapping[str, Any], *, whole: bool) -> Outcome:
    """The result of a run; without ``whole`` nothing but counts and what was left out."""
    rows: list[dict[str, Any]] = []
    files: dict[str, Any] = {}
    skipped: list[dict[str, str]] = []
    notes = list(batch.notes)
    empty: list[str] = []
    measured = metrics = 0
    for _, content in batch.results():
        measured += len(content["files"])
        metrics += len(content["metrics"])
        skipped += [{"file": file, "reason": reason} for file, reason in content["skipped"]]
        empty += [content["empty"]] if content["empty"] else []
        if whole:
            rows += [row | ({"file": file} if file else {}) for file, row in content["metrics"]]
            files |= dict(content["files"])
            notes += content["notes"]
    result = {"kind": "measure", "metrics": rows, "files": files, "skipped": skipped, "notes": notes, "settings": settings}
    lines = [f"# measured {measured} of {measured + len(skipped)} files: {metrics} metrics"]
    lines += [f"{batch.known} of {len(batch.units)} units of work were known from an earlier run"] if batch.known else []
    lines += [f"left out: {s['file']}: {s['reason']}" for s in skipped[:MOST_NAMED]]
    lines += [f"and {len(skipped) - MOST_NAMED} more (all of them with --json or -o)"] if len(skipped) > MOST_NAMED else []
    lines += [f"note: {note}" for note in (*batch.notes, *empty[:MOST_NAMED])]
    hashes = {file: str(about["sha256"]) for file, about in files.items()}
    nothing = not measured or (bool(empty) and len(empty) + len(skipped) >= len(batch.units))
    return Outcome(result, lines, BAD_INPUT if nothing else FINE, hashes, rows)
