"""The loop: ``simulate``, ``compare``, ``identify``, ``diagnose``, ``add``."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isetval.app.cli.batch_measure import add_cluster_options, add_engine_options, cluster_of, engine_for, has_engine
from isetval.app.cli.console import Console
from isetval.app.cli.curves import curve_options, shots_of
from isetval.app.cli.measure_command import shard
from isetval.app.cli.outcome import FINE, OUTSIDE_LIMITS, Outcome

if TYPE_CHECKING:
    from isetval.camera.model import CameraModel
    from isetval.core.campaign import Campaign


def register(commands: Any, common: argparse.ArgumentParser) -> None:
    """The commands and their options."""
    jobs = argparse.ArgumentParser(add_help=False, parents=[common])
    jobs.add_argument("-j", "--jobs", type=positive, default=default_jobs(), help="worker processes (default: %(default)s)")
    add_cluster_options(jobs)
    _register_simulate(commands, common)
    p = commands.add_parser(
        "compare", parents=[jobs], help="where does a model fail (several models: the ladder)", description=compare.__doc__
    )
    p.add_argument("models", nargs="+", metavar="MODEL", help="camera models (TOML); the last word is the campaign")
    p.add_argument("campaign", metavar="CAMPAIGN", help="folder with campaign.toml and captures, or a curve (--as)")
    curve_options(p)
    p.add_argument("--limits", type=Path, help="TOML file of limits on the families (column mean_square_z); outside: exit code 1")
    p.set_defaults(handler=compare, writes_result=True)
    p = commands.add_parser(
        "identify", parents=[jobs], help="what could be told apart, before measuring", description=identify.__doc__
    )
    p.add_argument("model", metavar="MODEL")
    p.add_argument("plan", metavar="PLAN", help="campaign.toml; its captures are not used")
    p.add_argument("--seed", type=int, default=0)
    p.set_defaults(handler=identify, writes_result=True)
    p = commands.add_parser(
        "diagnose",
        parents=[jobs],
        help="which effect is missing, how sure, what else, what next",
        description=diagnose.__doc__,
    )
    p.add_argument("model", metavar="MODEL")
    p.add_argument("campaign", metavar="CAMPAIGN", help="folder with campaign.toml and captures, or a curve (--as)")
    p.add_argument("--holdout", metavar="CAMPAIGN", help="captures to confirm on (default: the second measurement session)")
    p.add_argument(
        "--limit-s",
        metavar="SECONDS",
        type=positive_seconds,
        help="what it may take, half of it for naming; what it did not look at it says (default: 900; simulations are kept)",
    )
    curve_options(p)
    p.set_defaults(handler=diagnose, writes_result=True)
    _register_add(commands, common)


def _register_simulate(commands: Any, common: argparse.ArgumentParser) -> None:
    p = commands.add_parser(
        "simulate", parents=[common], help="a model shoots a plan: a campaign folder of DNGs", description=simulate.__doc__
    )
    p.add_argument("model", metavar="MODEL", help="camera model (TOML)")
    p.add_argument("plan", metavar="PLAN", help="campaign.toml or its folder; captures in it are not used")
    p.add_argument("--seed", type=int, default=0, help="same seed, same bits (default 0)")
    p.add_argument("--sensor-seed", type=int, help="the specimen: seed of the fixed patterns (default: the seed)")
    p.add_argument("--draw", action="store_true", help="draw the laboratory's nuisances from their priors (default: all 0)")
    add_engine_options(
        p.add_argument_group(
            "many processes", "With one of these an interrupted run goes on where it was when it is given again."
        )
    )
    p.add_argument("--shard", metavar="i/n", type=shard, help="only the i-th of n parts of the shots (for clusters)")
    p.set_defaults(handler=simulate, writes_result=False)


def _register_add(commands: Any, common: argparse.ArgumentParser) -> None:
    p = commands.add_parser("add", parents=[common], help="a model with one more effect, or new values", description=add.__doc__)
    p.add_argument("model", metavar="MODEL")
    p.add_argument(
        "effect", metavar="EFFECT", nargs="?", help="a name of the catalogue (isetval effects); none: all that a diagnosis names"
    )
    source = p.add_mutually_exclusive_group()
    source.add_argument(
        "--from", dest="diagnosis", metavar="d.json", type=Path, help="result of isetval diagnose, or of save_spectral_qe"
    )
    source.add_argument("--set", dest="settings", metavar="k=v", action="append", default=[], help="a parameter's value")
    p.set_defaults(handler=add, writes_result=False, suffixes=(".toml",))


def positive(text: str) -> int:
    """A whole number from 1."""
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of processes; write 1 or more")
    return int(text)


def positive_seconds(text: str) -> float:
    """A time above 0."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0 < seconds < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is no time; write seconds above 0")
    return seconds


def default_jobs() -> int:
    """Two workers where there are two cores."""
    return min(2, os.cpu_count() or 1)


def load_both(
    model: str, campaign: str, args: argparse.Namespace | None = None, *, as_plan: bool = False
) -> tuple[CameraModel, Campaign, dict[str, str]]:
    """A model, a campaign (or a curve, where ``args`` say so) and the hashes of their own files.

    Those of captures are known once they are measured; ``as_plan``, there need be none.
    """
    import isetval
    from isetval.camera.model_file import model_path
    from isetval.core.cache import file_hash
    from isetval.files.captures import input_hashes

    loaded = isetval.load_model(model)
    shots = shots_of(loaded, campaign, args, as_plan=as_plan)
    file = model_path(model)
    return loaded, shots, {str(file): file_hash(file)} | input_hashes(shots)


def simulate(args: argparse.Namespace, console: Console) -> Outcome:
    """A camera model shoots a plan: a campaign folder of DNG files that is measured like any other."""
    from dataclasses import replace

    from isetval.camera.shooting import draw_nuisances, shoot
    from isetval.core.errors import InputError
    from isetval.files.campaign_writer import write_campaign

    if args.output is None:
        raise InputError("simulate needs -o DIR: the folder to write the campaign to")
    model, plan, inputs = load_both(args.model, args.plan, as_plan=True)
    values = draw_nuisances(plan, args.seed) if args.draw else {}
    made = {"model": model.name, "model_sha256": model.digest(), "seed": args.seed, "nuisances": values}
    shot = tuple(replace(s, given=None) for s in plan.shots)  # what somebody measured is not simulated
    campaign = replace(plan.as_plan(), shots=shot, sensor=model.sensor, provenance=made)
    total = len(plan.shots)
    if args.shard or has_engine(args):
        return _simulate_on_engine(args, console, (model, plan, made), inputs)

    def shots() -> Any:
        made_shots = shoot(
            model,
            plan,
            args.seed,
            values=values,
            draw=args.draw,
            sensor_seed=args.sensor_seed,
            rendering=lambda done, all_passes, words: console.progress(f"rendering: {words}", done, all_passes),
        )
        console.say(f"shooting {plan.shots[0].name}")
        for i, (shot, frames) in enumerate(made_shots):
            console.progress(f"shooting {shot.name}", i + 1, total)
            yield shot, frames

    folder = write_campaign(campaign, args.output, model=model, captures=shots())
    files = sorted(p.name for p in folder.iterdir())
    result = {"kind": "simulate", "folder": str(folder), "shots": total, "files": files, "settings": made}
    frames = sum(shot.frames for shot in plan.shots)
    return Outcome(result, [f"{total} shots, {frames} frames written to {folder}"], FINE, inputs)


def _simulate_on_engine(
    args: argparse.Namespace, console: Console, what: tuple[CameraModel, Campaign, dict[str, Any]], inputs: dict[str, str]
) -> Outcome:
    from isetval.app.batch.shooting import shoot_on, shooting

    model, plan, made = what
    job = shooting(model, plan, made, seed=args.seed, values=made["nuisances"], draw=args.draw, sensor_seed=args.sensor_seed)
    target = Path(args.output)
    with engine_for(args) as engine:
        console.say(f"shooting {len(plan.shots)} shots")
        done, total = shoot_on(job, engine, target, part=args.shard, progress=console.progress)
    result = {"kind": "simulate", "folder": str(target), "shots": total, "done": done, "settings": made}
    frames = sum(shot.frames for shot in plan.shots)
    if done < total:
        words = f"{done} of {total} shots are there; {target} appears when the other parts are shot"
        return Outcome(result, [words], FINE, inputs)
    files = sorted(p.name for p in target.iterdir())
    return Outcome(result | {"files": files}, [f"{total} shots, {frames} frames written to {target}"], FINE, inputs)


def compare(args: argparse.Namespace, console: Console) -> Outcome:
    """Measure a campaign, simulate its plan with each model by the same estimators, and show where they differ."""
    import isetval
    from isetval.app.cli.loop_words import comparison_lines
    from isetval.app.limits import broken, load_limits
    from isetval.app.report_pictures import comparison_pictures
    from isetval.camera.model_file import model_path
    from isetval.core.cache import file_hash
    from isetval.loop.task_runner import on_cluster

    limits = load_limits(args.limits) if args.limits else ()
    model, campaign, inputs = load_both(args.models[0], args.campaign, args)
    models = [model, *(isetval.load_model(m) for m in args.models[1:])]
    inputs |= {m: file_hash(model_path(m)) for m in args.models}
    told = {"say": console.say, "progress": console.progress}
    with on_cluster(cluster_of(args)):
        found = isetval.compare(_distinct(models, args.models), campaign, regions=True, jobs=args.jobs, **told)
    inputs |= campaign.captures.hashes
    result: dict[str, Any] = {"kind": "compare", "campaign": campaign.name, **found.to_json()}
    if args.output is not None:  # the page that is drawn from the result shows them
        console.say("drawing captures beside simulations")
        result["pictures"] = comparison_pictures(found.models, campaign)
    faults = broken(limits, result["ladder"])
    lines = comparison_lines(result) + [f"outside limits: {fault}" for fault in faults]
    if limits:
        result["outside_limits"] = faults
    code = OUTSIDE_LIMITS if faults else FINE
    return Outcome(result, lines, code, inputs, result["table"])


def _distinct(models: list[CameraModel], files: list[str]) -> list[CameraModel]:
    """Models of one name are told apart by their files."""
    from dataclasses import replace

    names = [m.name for m in models]
    return [
        m if names.count(m.name) == 1 else replace(m, name=f"{m.name} ({Path(f).name})")
        for m, f in zip(models, files, strict=True)
    ]


def identify(args: argparse.Namespace, console: Console) -> Outcome:
    """Tell, before anything is measured, which effects a plan would show, how well, and which it could not tell apart."""
    import isetval
    from isetval.app.cli.loop_words import identify_lines
    from isetval.loop.task_runner import on_cluster
    from isetval.loop.telling import Teller

    model, plan, inputs = load_both(args.model, args.plan, as_plan=True)
    with on_cluster(cluster_of(args)):
        found = isetval.identify(model, plan, seed=args.seed, jobs=args.jobs, say=Teller(console.say, console.progress))
    result = {"kind": "identify", "plan": plan.name, "model": model.name, **found.to_json()}
    return Outcome(result, identify_lines(result), FINE, inputs, result["parameters"])


def diagnose(args: argparse.Namespace, console: Console) -> Outcome:
    """Name the physical effect that the model lacks (or say that none of the known ones explains the captures)."""
    import isetval
    from isetval.app.cli.loop_words import diagnosis_lines
    from isetval.files.captures import input_hashes
    from isetval.loop.task_runner import on_cluster

    model, campaign, inputs = load_both(args.model, args.campaign, args)
    holdout = shots_of(model, args.holdout, args) if args.holdout else None
    limit = {} if args.limit_s is None else {"limit_s": args.limit_s}
    with on_cluster(cluster_of(args)):
        found = isetval.diagnose(model, campaign, holdout, jobs=args.jobs, say=console.say, progress=console.progress, **limit)
    inputs |= campaign.captures.hashes
    inputs |= input_hashes(holdout) if holdout is not None else {}
    result: dict[str, Any] = {"kind": "diagnose", "model": model.name, "model_sha256": model.digest(), "campaign": campaign.name}
    result |= found.to_json()
    hint = {"model": args.model, "diagnosis": args.output or "d.json", "kept": args.output is not None}
    return Outcome(result, diagnosis_lines(result, hint), FINE, inputs, result["candidates"])


def add(args: argparse.Namespace, console: Console) -> Outcome:
    """Write a model file with one more effect, or with new values of one it has; comments of the file are kept."""
    from dataclasses import replace

    import isetval
    from isetval.core.cache import file_hash
    from isetval.core.errors import InputError
    from isetval.loop.model_update import add_effect, from_result, from_settings, named_effects

    if args.output is None:
        raise InputError("add needs -o MODEL2: the model file to write")
    if args.effect is None and args.diagnosis is None:
        raise InputError("add needs the name of an effect (isetval effects), or --from a diagnosis that names some")
    model = isetval.load_model(args.model)
    inputs = {str(model.path): file_hash(str(model.path))}
    if args.diagnosis is not None:
        names = [args.effect] if args.effect else named_effects(args.diagnosis)
        every = [from_result(name, args.diagnosis) for name in names]
        inputs[str(args.diagnosis)] = file_hash(args.diagnosis)
    else:
        every = [from_settings(args.effect, args.settings)]
    made, lines = model, []
    for values in every:
        made = add_effect(replace(made, name=model.name), values, output=args.output)
        lines.append(f"{made.name}: {values.words()}; written to {args.output}")
    added = [{"effect": values.effect, "values": dict(values.values)} for values in every]
    return Outcome({"kind": "add", "model": made.name, "file": args.output, "added": added} | added[0], lines, FINE, inputs)
