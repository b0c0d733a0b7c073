"""``demo``, ``challenge make | reveal``, ``campaign init``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from isetval.app.cli.batch_measure import add_engine_options, engine_for
from isetval.app.cli.console import Console
from isetval.app.cli.loop_commands import default_jobs, load_both, positive
from isetval.app.cli.measure_command import shard
from isetval.app.cli.outcome import BAD_INPUT, FINE, Outcome

CHALLENGE_KINDS = ("null", "single", "pair", "form", "outsider")  # as in isetval.app.challenge, which takes time to import


def register_demo(commands: Any, common: argparse.ArgumentParser) -> None:
    """``isetval demo``."""
    p = commands.add_parser(
        "demo", parents=[common], help="the whole loop on the embedded campaign, report at the end", description=demo.__doc__
    )
    p.add_argument(
        "--seed", type=int, help="draws the hidden effect, the specimen and the laboratory's errors (default: a fixed one)"
    )
    p.add_argument(
        "--hide",
        metavar="NAME[:p=v,...]",
        help="the effect to hide; your own as my_effect.py with --allow-plugin "
        "(default: drawn by the seed; without values at twice its plausible scale)",
    )
    p.add_argument("-j", "--jobs", type=positive, default=default_jobs(), help="worker processes (default: %(default)s)")
    p.add_argument("--open", action="store_true", help="open the report")
    p.set_defaults(handler=demo, writes_result=False)


def register(commands: Any, common: argparse.ArgumentParser) -> None:
    """``isetval challenge`` and ``isetval campaign``."""
    actions = commands.add_parser("challenge", help="sealed hidden effects: make, reveal").add_subparsers(
        metavar="ACTION", required=True
    )
    p = actions.add_parser(
        "make",
        parents=[common],
        help="shoot a plan with hidden effects, by other code than the catalogue",
        description=challenge_make.__doc__,
    )
    p.add_argument("model", metavar="MODEL", help="the nominal model, which the solver knows")
    p.add_argument("plan", metavar="PLAN")
    p.add_argument("--truth", type=Path, help="where the truth goes (default: DIR.truth.json); another party keeps it")
    p.add_argument("--kind", choices=CHALLENGE_KINDS, help="what is hidden (default: drawn)")
    p.add_argument("--seed", type=int, help="for tests; by default nobody knows it")
    add_engine_options(
        p.add_argument_group("many processes", "An interrupted command goes on where it was when it is given again.")
    )
    p.add_argument("--shard", metavar="i/n", type=shard, help="only the i-th of n parts of the shots (for clusters)")
    p.set_defaults(handler=challenge_make, writes_result=False)
    p = actions.add_parser(
        "reveal", parents=[common], help="open a challenge and score an answer", description=challenge_reveal.__doc__
    )
    p.add_argument("folder", metavar="DIR", type=Path)
    p.add_argument("--truth", type=Path, help="the truth file (default: DIR.truth.json)")
    p.add_argument("--diagnosis", type=Path, metavar="d.json", help="the answer: a result of isetval diagnose")
    p.set_defaults(handler=challenge_reveal, writes_result=True)
    actions = commands.add_parser("campaign", help="campaign folders: init, check").add_subparsers(
        metavar="ACTION", required=True
    )
    p = actions.add_parser(
        "init", parents=[common], help="a folder of raw files becomes a campaign that runs", description=campaign_init.__doc__
    )
    p.add_argument("folder", metavar="FOLDER", type=Path)
    p.add_argument("--role", choices=("dark", "flat", "edge", "chart", "scene"), help="what all files show (default: found out)")
    p.add_argument(
        "--camera", default="", metavar="MODEL", help="the nominal camera model: a file, or isetval:NAME (isetval cameras)"
    )
    p.add_argument(
        "--scene",
        default="",
        metavar="SCENE",
        help="scene file of what stands in the pictures of charts and edges (in FOLDER, or isetval:scenes/cornell_box.toml): "
        "finds the camera's pose in it",
    )
    p.add_argument("--open", action="store_true", help="open the page with the pictures of what was found")
    p.set_defaults(handler=campaign_init, writes_result=True)
    p = actions.add_parser(
        "check", parents=[common], help="what a campaign would measure now", description=campaign_check.__doc__
    )
    p.add_argument("folder", metavar="FOLDER", type=Path)
    p.set_defaults(handler=campaign_check, writes_result=False)


def demo(args: argparse.Namespace, console: Console) -> Outcome:
    """Shoot the embedded plan with a camera in which one effect is hidden; compare, diagnose, add, compare again; reveal."""
    from isetval.app.cli.loop_words import demo_lines
    from isetval.app.demo import DEFAULT_SEED, run_demo
    from isetval.loop.telling import Teller

    seed = DEFAULT_SEED if args.seed is None else args.seed
    folder = Path(args.output or "isetval-demo")

    told = Teller(console.say, console.progress)
    found = run_demo(seed, folder=folder, hide=_hidden_of(args.hide), jobs=args.jobs, step=console.step, say=told)
    return Outcome(found, demo_lines(found), FINE)


def _hidden_of(hide: str | None) -> str | None:
    """What ``--hide`` names; of a file of effects (`isetval effects new`), the effect that is called like it, or its only one."""
    from isetval.camera.plugins import load_plugin
    from isetval.core.errors import InputError

    file, colon, settings = (hide or "").partition(":")
    if not file.endswith(".py"):
        return hide
    path = Path(file).resolve()
    names = load_plugin(path.name, path.parent / "--hide")
    name = path.stem if path.stem in names else names[0]
    if name != path.stem and len(names) > 1:
        raise InputError(f"--hide {file}: holds {', '.join(names)}; call the file like the one that is to be hidden")
    return name + colon + settings


def challenge_make(args: argparse.Namespace, console: Console) -> Outcome:
    """Shoot a plan with a second, independent camera that hides effects or none, and seal which by a SHA-256 of the truth."""
    from isetval.app.challenge import make_challenge
    from isetval.core.errors import InputError

    if args.output is None:
        raise InputError("challenge make needs -o DIR: the folder to write the challenge to")
    model, plan, inputs = load_both(args.model, args.plan, as_plan=True)
    truth = args.truth or Path(f"{args.output}.truth.json")
    console.say("shooting the plan")
    with engine_for(args) as engine:
        made = make_challenge(
            model,
            plan,
            args.output,
            truth_file=truth,
            seed=args.seed,
            kind=args.kind,
            engine=engine,
            part=args.shard,
            progress=console.progress,
        )
    missing = f" appears when the other parts are shot: {made['done']} of {made['shots']} shots are there"
    lines = [
        f"challenge: {args.output}{missing if made['done'] < made['shots'] else ''}",
        f"commitment: {made['commitment']}",
        f"truth: {truth} (give it to another party, unread)",
    ]
    return Outcome({"kind": "challenge make", "folder": args.output, "truth": str(truth), **made}, lines, FINE, inputs)


def challenge_reveal(args: argparse.Namespace, console: Console) -> Outcome:
    """Check the truth file against the commitment, print it, and score a diagnosis."""
    from isetval.app.challenge import reveal_challenge
    from isetval.core.cache import file_hash
    from isetval.files.result_file import Answer, read_as

    truth = args.truth or Path(f"{args.folder}.truth.json")
    answer = read_as(args.diagnosis, Answer) if args.diagnosis else None
    found = reveal_challenge(args.folder, truth, diagnosis=answer)
    lines = ["the truth is the one that was sealed", f"hidden: {_hidden_words(found.truth)}"]
    if found.score:
        s = found.score
        first, whole = ("right" if s[key] else "wrong" for key in ("first_right", "class_right"))
        lines.append(f"answer: verdict {s['verdict']}; first name {first}, class {whole}")
        lines.append(f"missed: {', '.join(s['missed']) or 'none'}; invented: {', '.join(s['invented']) or 'none'}")
        lines += [f"pull of {key}: {pull:+.2f} sigma" for key, pull in s["pulls"].items()]
    result = {"kind": "challenge reveal", "truth": found.truth, "score": found.score}
    return Outcome(result, lines, FINE, {str(truth): file_hash(truth)})


def _hidden_words(truth: Any) -> str:
    parts = [f"{e['name']} ({', '.join(f'{k} {v:g}' for k, v in e['parameters'].items())})" for e in truth["effects"]]
    return " and ".join(parts) or "nothing"


def campaign_init(args: argparse.Namespace, console: Console) -> Outcome:
    """Group and register the raw files of a folder into a campaign.toml that runs at once; campaign.html shows what was found."""
    from isetval.app.report.campaign_page import write_campaign_page
    from isetval.core.cache import file_hash
    from isetval.core.errors import InputError
    from isetval.core.toml import PACKAGE_PREFIX
    from isetval.files.chart_parts import write_chart_parts
    from isetval.files.draft import check_free, draft_campaigns, write_draft
    from isetval.files.draft_text import sentences
    from isetval.files.emva_lines import descriptors_below, find_emva_descriptor

    descriptor = find_emva_descriptor(args.folder)
    if descriptor is not None:
        return _init_from_descriptor(descriptor, args.camera, console)
    if below := descriptors_below(args.folder):
        raise InputError(
            f"{args.folder}: has no EMVA 1288 descriptor of its own, but {len(below)} in its sub-folders; "
            f"give each set by itself: isetval campaign init {below[0].parent}"
        )
    check_free(args.folder, "campaign.toml", "campaign.html")
    console.say(f"reading the files of {args.folder}")
    draft, *others = draft_campaigns(args.folder, role=args.role, camera=args.camera, scene=args.scene, progress=console.progress)
    roles = [shot.role for shot in draft.shots]
    lines, made, parted = [], [], []
    for one in (draft, *others):
        path, page = write_draft(one, args.folder), write_campaign_page(one, args.folder)
        made.append((str(path), str(page)))
        own = [shot.role for shot in one.shots]
        counts = ", ".join(f"{own.count(role)} {role}" for role in dict.fromkeys(own))
        lines.append(f"{path}: {len(own)} shots ({counts}); pictures of what was found: {page}")
        if parts := write_chart_parts(path):
            learn, confirm, judge = parts
            words = f"parts of {path.name} to learn from, to confirm on, and to judge by"
            lines.append(f"{learn.name}, {confirm.name}, {judge.name}: {words}, in the brightest colour of each band")
            parted.append(f"next: isetval diagnose {args.camera or 'CAMERA.toml'} {learn} --holdout {confirm} -o d.json")
    for one in others:
        pitch = f"{one.seen[0].group.first.sensor.pixel_um:g} um"
        lines.append(f"note: {one.file} holds the files with pixels of {pitch}; give it as --holdout")
    lines += [f"not known: {words}" for words in sentences(draft.unknown)]
    lines += [f"not used: {one.group.first.folder or '.'}: {one.content.why}" for one in draft.seen if not one.shots]
    lines += left_out_lines(draft.skipped)
    lines += [f"note: {note}" for note in draft.notes]
    lines.append(f"next: isetval measure {args.folder}")
    if draft.camera:
        model = draft.camera if draft.camera.startswith(PACKAGE_PREFIX) else args.folder / draft.camera
        lines.append(f"next: isetval compare {model} {args.folder}")
    lines += parted
    result = {
        "kind": "campaign init",
        "file": made[0][0],
        "page": made[0][1],
        "further": [{"file": file, "page": page} for file, page in made[1:]],
        "shots": len(roles),
        "roles": {role: roles.count(role) for role in dict.fromkeys(roles)},
        "unknown": [list(row) for row in draft.unknown],
        "skipped": [list(s) for s in draft.skipped],
        "notes": list(draft.notes),
    }
    return Outcome(result, lines, FINE, {file: file_hash(Path(file)) for file, _ in made})


def _init_from_descriptor(descriptor: Path, camera: str, console: Console) -> Outcome:
    """The series of an EMVA 1288 descriptor as a campaign.toml."""
    from isetval.core.cache import file_hash
    from isetval.files.emva_draft import CAMERA, part_name, write_emva_campaign
    from isetval.files.emva_estimates import PARTS

    console.say(f"reading the series of {descriptor}")
    path, campaign = write_emva_campaign(descriptor, camera=camera)
    roles = [shot.role for shot in campaign.shots]
    lines = [f"{path}: {len(roles)} shots ({roles.count('flat')} flat, {roles.count('dark')} dark) of {descriptor.name}"]
    lines += [f"not known: {note}" for note in campaign.notes]
    folder = descriptor.parent
    learn, confirm, judge = (folder / part_name(part) for part in PARTS)
    lines.append(f"{learn.name}, {confirm.name}, {judge.name}: parts of it to learn from, to confirm on, and to judge by")
    lines.append(f"next: isetval measure {folder}")
    model = camera or (folder / CAMERA if (folder / CAMERA).is_file() else "CAMERA.toml")
    lines.append(f"next: isetval diagnose {model} {learn} --holdout {confirm} -o d.json")
    result = {
        "kind": "campaign init",
        "file": str(path),
        "page": None,
        "shots": len(roles),
        "roles": {role: roles.count(role) for role in dict.fromkeys(roles)},
        "unknown": [],
        "skipped": [],
        "notes": list(campaign.notes),
    }
    return Outcome(result, lines, FINE, {str(path): file_hash(path), str(descriptor): file_hash(descriptor)})


def left_out_lines(skipped: Sequence[tuple[str, str]]) -> list[str]:
    """Files that were left out, those with one and the same reason in one line."""
    by_reason: dict[str, list[str]] = {}
    for file, reason in skipped:
        by_reason.setdefault(reason, []).append(file)
    return [
        f"left out: {files[0]}{f' and {len(files) - 1} more' if len(files) > 1 else ''}: {reason}"
        for reason, files in by_reason.items()
    ]


def campaign_check(args: argparse.Namespace, console: Console) -> Outcome:
    """Read a campaign as measure would, open every file, and tell shot by shot what would be measured and what would not."""
    import isetval
    from isetval.app.cli.tables import text_table
    from isetval.files.campaign_check import check_campaign, doubts_of_all
    from isetval.files.captures import input_hashes

    console.say(f"reading {args.folder}")
    campaign = isetval.load_campaign(args.folder)
    rows = check_campaign(campaign, progress=console.progress)
    header = ("shot", "role", "session", "frames", "analyses", "doubts")
    body = [(r.shot, r.role, r.session, f"{r.readable}/{r.frames}", " ".join(r.analyses), "; ".join(r.doubts)) for r in rows]
    lines = [f"# {campaign.name}: {sum(bool(r.readable) for r in rows)} of {len(rows)} shots would be measured"]
    lines += text_table(header, body)
    lines += left_out_lines(campaign.captures.skipped)
    doubts = doubts_of_all(campaign)
    lines += [f"doubtful: {words}" for words in doubts]
    result = {
        "kind": "campaign check",
        "campaign": campaign.name,
        "doubts": doubts,
        "shots": [vars(r) for r in rows],
        "skipped": [{"file": file, "reason": reason} for file, reason in campaign.captures.skipped],
    }
    return Outcome(result, lines, FINE if any(r.readable for r in rows) else BAD_INPUT, input_hashes(campaign))
