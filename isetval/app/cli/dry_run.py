"""``--dry-run``: what a command would read and write, after everything that can be checked beforehand was checked."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from isetval.app.cli.console import Console
from isetval.app.cli.curves import shots_of
from isetval.app.cli.outcome import FINE, Outcome

if TYPE_CHECKING:
    from isetval.camera.model import CameraModel
    from isetval.core.campaign import Campaign

MOST_NAMED = 20  # files that are named one by one


def dry_run(args: argparse.Namespace, console: Console) -> Outcome:
    """Nothing is measured, simulated or written: models, campaigns and file names are read and told."""
    model, lines = _models(args)
    for key in ("campaign", "plan"):
        if (named := getattr(args, key, None)) is not None and model is not None:
            lines += _campaign_lines(shots_of(model, named, args if hasattr(args, "curve") else None, as_plan=key == "plan"))
    if hasattr(args, "paths"):
        lines += _path_lines(args)
    for key in ("results", "result", "file", "folder", "image"):
        named = getattr(args, key, None)
        lines += [f"would read {name}" for name in (named if isinstance(named, list) else [named] if named else [])]
    if args.output is not None:
        there = Path(args.output).exists()
        lines.append(f"would write {args.output}{' (it exists)' if there else ''}")
    lines.append("dry run: nothing was measured, simulated or written")
    return Outcome({"kind": "dry run", "would": lines[:-1]}, lines, FINE)


def _models(args: argparse.Namespace) -> tuple[CameraModel | None, list[str]]:
    import isetval

    names = [*getattr(args, "models", ()), *([args.model] if getattr(args, "model", None) else [])]
    loaded: list[CameraModel] = [isetval.load_model(name) for name in names]
    return (loaded[0] if loaded else None), [f"model {m.name}: {len(m.effects)} effects, {m.path}" for m in loaded]


def _campaign_lines(campaign: Campaign) -> list[str]:
    roles = Counter(shot.role for shot in campaign.shots)
    frames = sum(len(shot.files) or shot.frames for shot in campaign.shots)
    said = ", ".join(f"{count} {role}" for role, count in roles.items())
    return [f"campaign {campaign.name}: {len(campaign.shots)} shots ({said}), {frames} frames"]


def _path_lines(args: argparse.Namespace) -> list[str]:
    import isetval
    from isetval.app.cli.measure_command import is_campaign, raw_settings
    from isetval.files.loose_files import levels_are_said, raw_files

    if len(args.paths) == 1 and args.role is None and is_campaign(args.paths[0]):
        return _campaign_lines(isetval.load_campaign(args.paths[0]))
    paths = raw_files(args.paths, said=levels_are_said(raw_settings(args)))
    if args.shard:
        part, parts = args.shard
        paths = paths[part - 1 :: parts]
    more = [f"and {len(paths) - MOST_NAMED} more"] if len(paths) > MOST_NAMED else []
    return [f"would measure {len(paths)} files", *(f"  {path}" for path in paths[:MOST_NAMED]), *more]
