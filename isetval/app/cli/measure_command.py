"""``isetval measure``: files, folders and campaigns to metrics."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isetval.app.cli.batch_measure import add_batch_options, is_batch, measure_batch
from isetval.app.cli.console import Console
from isetval.app.cli.outcome import BAD_INPUT, FINE, MEASURED_SUFFIXES, OUTSIDE_LIMITS, Outcome

if TYPE_CHECKING:
    from isetval.app.measurement_sheets import Note
    from isetval.app.plots.sheets import Sheet
    from isetval.core.campaign import Campaign
    from isetval.core.metric import Metric, MetricTable
    from isetval.files.loose_files import FileMeasurement

_SKIP = ("summary", "count")


def register(commands: Any, common: argparse.ArgumentParser) -> None:
    """The command and its options."""
    p = commands.add_parser(
        "measure",
        parents=[common],
        help="DNGs, a folder of them or a campaign -> metrics with sigma",
        description="Measure DNG files, folders or a campaign. Without --role, each file is searched for a 24-patch chart, then "
        "for slanted edges. Files that cannot be read are listed with the reason; the others are measured.",
    )
    p.add_argument(
        "paths",
        nargs="+",
        metavar="PATH",
        type=Path,
        help="DNG files, folders, or a campaign: a folder with campaign.toml or an EMVA 1288 descriptor",
    )
    p.add_argument("--role", choices=("dark", "flat", "edge", "chart", "disk", "scene"), help="what the files show")
    p.add_argument(
        "--dark", metavar="PATH", type=Path, nargs="+", default=[], help="darks (files, folders) of the flats of --role flat"
    )
    p.add_argument(
        "--method",
        default="",
        help="another method than the estimators' own: iso12233:2000, iso12233:2017, iso12233:2023, lyu2022",
    )
    p.add_argument("--channel", default="", help="one channel of edges and scenes: R, Gr, Gb, B or G (both greens)")
    p.add_argument("--roi", metavar="R0,R1,C0,C1", type=region, help="rows R0 to R1 and columns C0 to C1 of each file, half open")
    p.add_argument("--regions", metavar="FILE", type=Path, help="the regions of a TOML file (isetval roi draws them)")
    p.add_argument("--gain-dn-per-e", type=float, metavar="K", help="stated conversion gain, for --role scene --method lyu2022")
    p.add_argument(
        "--black",
        choices=("auto", "tag", "optical"),
        help="black level: optical black where it differs from the tag (auto: the default), the tag, or optical black only",
    )
    p.add_argument("--raw-shape", metavar="ROWSxCOLS", type=raw_shape, help="the files are headerless raw of this size")
    p.add_argument("--cfa", help="colour pattern of headerless raw or of a TIFF, PNG or NPY: RGGB, BGGR, GRBG, GBRG or MONO")
    p.add_argument("--bits", type=int, help="bits of headerless raw or of a picture, 1 to 16")
    p.add_argument("--black-dn", type=float, help="black level of headerless raw or of a picture in DN")
    p.add_argument("--limits", type=Path, help="TOML file of limits; a value outside them gives exit code 1")
    p.add_argument("--shard", metavar="i/n", type=shard, help="only the i-th of n parts of the files (for clusters)")
    p.add_argument(
        "--curves", action="store_true", help="SFR, edge profiles, photon transfer, fall-off in the JSON (measures again)"
    )
    p.add_argument("--open", action="store_true", help="open the page that -o wrote")
    add_batch_options(p)
    p.set_defaults(handler=measure, writes_result=True, suffixes=MEASURED_SUFFIXES)


def raw_shape(text: str) -> tuple[int, int]:
    """``ROWSxCOLS`` as two numbers."""
    found = re.fullmatch(r"(\d+)[xX](\d+)", text)
    if not found:
        raise argparse.ArgumentTypeError(f"{text!r} is no size; write ROWSxCOLS, as 3024x4032")
    return int(found[1]), int(found[2])


def region(text: str) -> tuple[int, int, int, int]:
    """``r0,r1,c0,c1`` as four numbers, half open."""
    found = re.fullmatch(r"(\d+),(\d+),(\d+),(\d+)", text.replace(" ", ""))
    if not found or not (int(found[1]) < int(found[2]) and int(found[3]) < int(found[4])):
        raise argparse.ArgumentTypeError(f"{text!r} is no region; write r0,r1,c0,c1 with r0 < r1 and c0 < c1, as 100,200,40,160")
    return int(found[1]), int(found[2]), int(found[3]), int(found[4])


def shard(text: str) -> tuple[int, int]:
    """``i/n`` as two numbers, i from 1 to n."""
    found = re.fullmatch(r"(\d+)/(\d+)", text)
    if not found or not 1 <= int(found[1]) <= int(found[2]):
        raise argparse.ArgumentTypeError(f"{text!r} is no part; write i/n with i from 1 to n, as 2/8")
    return int(found[1]), int(found[2])


def measure(args: argparse.Namespace, console: Console) -> Outcome:
    """Measure what the paths hold."""
    from isetval.app.limits import load_limits
    from isetval.core.errors import InputError

    limits = load_limits(args.limits) if args.limits else ()
    if args.dark and (args.role != "flat" or is_batch(args)):
        raise InputError(
            "--dark names the darks of --role flat, and goes without --jobs, --scheduler, --shard, --store and --isolate"
        )
    raw = raw_settings(args)
    if args.regions is not None:
        outcome = _drawn_regions(args, console)
    elif is_batch(args):
        outcome = measure_batch(args, console, raw)
    elif len(args.paths) == 1 and raw is None and args.role is None and is_campaign(args.paths[0]):
        outcome = _measure_campaign(args, console)
    else:
        outcome = _measure_files(args, console, raw)
    from isetval.app.limits import broken

    faults = broken(limits, outcome.result["metrics"])
    lines = [*outcome.lines, *([""] if faults else []), *(f"outside limits: {fault}" for fault in faults)]
    code = OUTSIDE_LIMITS if faults else outcome.code
    result = {**outcome.result, **({"outside_limits": faults} if limits else {})}
    return replace(outcome, result=result, lines=lines, code=code)


def _drawn_regions(args: argparse.Namespace, console: Console) -> Outcome:
    from isetval.app.cli.region_commands import measure_regions
    from isetval.core.errors import InputError

    paged = args.output is not None and Path(args.output).suffix.lower() in MEASURED_SUFFIXES
    given = {"--roi": args.roi, "--role": args.role, "--curves": args.curves, "--shard": args.shard, "a page": paged}
    if named := [name for name, value in given.items() if value]:
        raise InputError(f"--regions measures edges, patches and lines as drawn; leave out {', '.join(named)}")
    return measure_regions(args, console)


def _with_pages(
    outcome: Outcome,
    args: argparse.Namespace,
    console: Console,
    draw: Callable[[Note], list[Sheet]],
    half_diagonal_mm: float = 0.0,
) -> Outcome:
    """The outcome with its pictures, where a page or the curves are asked for."""
    pictured = args.output is not None and Path(args.output).suffix.lower() in MEASURED_SUFFIXES
    if not (pictured or args.curves):
        return outcome
    console.say("drawing what was measured")
    remarks: list[str] = []
    sheets = draw(remarks.append)
    if str(args.output).lower().endswith(".xml"):
        return replace(outcome, page=lambda suffix, whole: _emva_xml(args.output, sheets))
    curves = {sheet.title: dict(sheet.curves) for sheet in sheets if sheet.curves}
    result = {**outcome.result, "curves": curves, "notes": [*outcome.result["notes"], *remarks]}
    lines = [*outcome.lines, *(f"note: {remark}" for remark in remarks)]

    def page(suffix: str, whole: Mapping[str, Any]) -> bytes:
        from isetval.app.headline import headline_tables
        from isetval.app.report.measurement import measurement_html, measurement_picture

        if suffix in (".pdf", ".png"):
            return measurement_picture(sheets, suffix[1:])
        tables = headline_tables(whole["metrics"], files=whole.get("files"), half_diagonal_mm=half_diagonal_mm, sign="±")
        return measurement_html(whole, tables, sheets).encode("utf-8", "backslashreplace")

    return replace(outcome, result=result, lines=lines, page=page)


def _emva_xml(output: str, sheets: Sequence[Sheet]) -> bytes:
    """The tables of EMVA 1288 of every series of flats."""
    from isetval.core.errors import InputError
    from isetval.files.emva_datasheet import to_xml

    tables = {sheet.title.removesuffix(": photon transfer"): sheet.emva for sheet in sheets if sheet.emva}
    if not tables:
        raise InputError(
            f"{output}: a table of EMVA 1288 needs a series of flats of two frames and more at several levels (and darks); none "
            "was found; name a campaign (isetval campaign init FOLDER), or a folder of flats with --role flat"
        )
    return to_xml(tables)


def is_campaign(path: Path) -> bool:
    """Whether a path is a campaign: its file, its folder, or one with an EMVA 1288 descriptor."""
    from isetval.files.emva_lines import find_emva_descriptor

    own = (path / "campaign.toml").is_file() or path.suffix.lower() == ".toml"
    return own or find_emva_descriptor(path) is not None


def raw_settings(args: argparse.Namespace) -> Mapping[str, Any] | None:
    """What is said of headerless raw, or of pictures that no sidecar describes."""
    from isetval.core.errors import InputError
    from isetval.files.image_file import SUFFIXES

    given = {"--raw-shape": args.raw_shape, "--cfa": args.cfa, "--bits": args.bits}
    if all(v is None for v in (*given.values(), args.black_dn)):
        return None
    pictures = [path for path in args.paths if path.is_dir() or path.suffix.lower() in SUFFIXES]
    if len(pictures) == len(args.paths) and args.raw_shape is None:
        said = {"cfa": args.cfa and args.cfa.upper(), "bits": args.bits, "black_dn": args.black_dn}
        return {key: value for key, value in said.items() if value is not None}
    missing = [name for name, value in given.items() if value is None]
    if missing:
        raise InputError(f"headerless raw needs --raw-shape, --cfa and --bits; {', '.join(missing)} is missing: add it")
    return {"shape": args.raw_shape, "cfa": args.cfa.upper(), "bits": args.bits, "black_dn": args.black_dn}


def _measure_campaign(args: argparse.Namespace, console: Console) -> Outcome:
    import isetval
    from isetval.app.cli.file_words import headline_lines
    from isetval.app.measurement_sheets import sheets_of_campaign
    from isetval.app.remarks import quality_first
    from isetval.files.captures import input_hashes

    path = args.paths[0]
    _refuse_options(args, path)
    console.say(f"reading {path}")
    campaign = isetval.load_campaign(path)
    table = isetval.measure_campaign(campaign, progress=console.progress)
    verdicts = _verdicts(campaign, console)
    skipped = campaign.captures.skipped
    rows = [metric_row(m, sigma) for m, sigma in zip(table.metrics, table.sigma, strict=True)]
    result = {
        "kind": "measure",
        "campaign": campaign.name,
        "metrics": rows,
        "skipped": [{"file": file, "reason": reason} for file, reason in skipped],
        "notes": [*verdicts, *table.notes],
        "settings": dict(table.settings) | {"choices": dict(table.choices)},
    }
    half_diagonal_mm = campaign.sensor.half_diagonal_mm if campaign.sensor else 0.0
    lines = [*quality_first(verdicts)[0], *headline_lines(rows, half_diagonal_mm=half_diagonal_mm), *_campaign_lines(table)]
    outcome = Outcome(result, lines, FINE, input_hashes(campaign), rows)
    return _with_pages(outcome, args, console, lambda note: sheets_of_campaign(campaign, note), half_diagonal_mm)


def _verdicts(campaign: Campaign, console: Console) -> list[str]:
    """The quality of the first frame of every set-up, file by file."""
    from isetval.files.loose_files import quality_note

    first = {shot.files[0]: shot for shot in campaign.shots if shot.files and shot.name in campaign.captures}
    out = []
    for i, (file, shot) in enumerate(first.items(), 1):
        frames = campaign.captures.read(shot.name)
        out += [f"{Path(file).name}: {quality_note(frames[0], cut=shot.window is not None)}"] if len(frames) else []
        console.progress("judging the quality of captures", i, len(first))
    return out


def _refuse_options(args: argparse.Namespace, path: Path) -> None:
    """A campaign states the options of its estimators shot by shot."""
    from isetval.core.errors import InputError

    given = {"--method": args.method, "--channel": args.channel, "--roi": args.roi, "--gain-dn-per-e": args.gain_dn_per_e}
    if named := [name for name, value in given.items() if value]:
        raise InputError(
            f"{path}: a campaign states method and channel in its [[shot]] tables and regions in its targets; "
            f"leave out {', '.join(named)}, or add --role to measure the files without their campaign"
        )


def _campaign_lines(table: MetricTable) -> list[str]:
    from isetval.app.cli.tables import text_table

    families: dict[tuple[str, str], list[Metric]] = {}
    for m in table.metrics:
        families.setdefault((m.role, m.family), []).append(m)
    shots = {m.shot for m in table.metrics if m.shot}  # summaries of a session have none
    lines = [f"# {len(table.metrics)} metrics of {len(shots)} shots"]
    body = [
        (role, family, len(rows), len({m.shot for m in rows}), " ".join(dict.fromkeys(m.unit for m in rows)))
        for (role, family), rows in families.items()
    ]
    lines += text_table(("role", "family", "n", "shots", "unit"), body)
    return lines + _doubt_lines((), table.notes)


def _doubt_lines(skipped: Iterable[tuple[str, str]], notes: Iterable[str]) -> list[str]:
    from isetval.app.cli.file_words import counted_rejections
    from isetval.app.remarks import gathered, quality_first

    lines = [f"left out: {file}: {reason}" for file, reason in skipped]
    verdicts, others = quality_first(counted_rejections(list(notes)))
    return lines + [f"note: {note}" for note in (*verdicts, *gathered(others))]


def metric_row(m: Metric, sigma: float, *, file: str = "") -> dict[str, Any]:
    """A metric as a flat row without the fields it leaves empty; ``sigma`` includes shared parts."""
    row = {k: v for k, v in vars(m).items() if v not in ("", None) and k not in _SKIP}
    return row | {"sigma": float(sigma)} | ({"file": file} if file else {})


def _measure_files(args: argparse.Namespace, console: Console, raw: Mapping[str, Any] | None) -> Outcome:
    from isetval.app.measurement_sheets import sheets_of_campaign, sheets_of_files
    from isetval.files.loose_files import Asked, file_reader, levels_are_said, measure_files, raw_files

    paths = raw_files(args.paths, said=levels_are_said(raw))
    if args.shard:
        part, parts = args.shard
        paths = paths[part - 1 :: parts]
    darks = tuple(raw_files(args.dark, said=levels_are_said(raw)))
    single = len(paths) == 1
    black = args.black or "auto"
    console.say(f"measuring {len(paths) + len(darks)} files")
    asked = Asked(args.role, args.method, args.channel, args.roi, args.gain_dn_per_e, darks)
    read = file_reader(black=black, raw=raw, channel=args.channel)
    found = measure_files(paths, read=read, asked=asked, progress=console.progress)
    rows = [metric_row(m, m.sigma, file=file) for file, m in found.metrics]
    result = {
        "kind": "measure",
        "metrics": rows,
        "files": found.files,
        "skipped": [{"file": file, "reason": reason} for file, reason in found.skipped],
        "notes": list(found.notes),
        "settings": dict(found.settings) | {"black": black, "raw": raw},
    }
    hashes = {file: str(about["sha256"]) for file, about in found.files.items()}
    lines = [*_file_lines(found, rows, brief=not single), *([found.empty] if found.empty else [])]
    outcome = Outcome(result, lines, BAD_INPUT if found.empty else FINE, hashes, rows)

    def draw(note: Note) -> list[Sheet]:
        if found.campaign is not None:
            return sheets_of_campaign(found.campaign, note)
        good = [path for path in paths if str(path) in found.files]
        return sheets_of_files(good, read, role=args.role, channel=args.channel, note=note)

    return _with_pages(outcome, args, console, draw)


def _file_lines(found: FileMeasurement, rows: Sequence[Mapping[str, Any]], *, brief: bool) -> list[str]:
    from isetval.app.cli.file_words import file_lines, folder_lines, headline_lines, metric_lines
    from isetval.app.remarks import quality_first

    verdicts, others = quality_first(found.notes)
    lines: list[str] = folder_lines(found.files, verdicts) if brief else []
    for file, about in () if brief else found.files.items():
        head = file_lines(file, about)
        lines += [*head[:2], *(f"  {verdict.partition(': ')[2]}" for verdict in verdicts), *head[2:]]
    lines += headline_lines(rows, found.files)
    lines += metric_lines([m for _, m in found.metrics], files=[f for f, _ in found.metrics], brief=brief)
    if brief:
        lines.append(f"# measured {len(found.files)} of {len(found.files) + len(found.skipped)} files")
        lines += _series_hint(found)
    return lines + _doubt_lines(found.skipped, others)


def _series_hint(found: FileMeasurement) -> list[str]:
    """What to do with files of an unknown role that show nothing: darks and flats tell what they hold as a series."""
    shown = {file for file, m in found.metrics if m.family != "plane"}
    bare = [file for file in found.files if file not in shown]
    if found.settings.get("role") or len(bare) < 2:
        return []
    return [
        f"hint: {len(bare)} files show neither a chart nor an edge; darks and flats are series: isetval measure FLATS "
        "--role flat --dark DARKS, or isetval campaign init FOLDER, which sorts them"
    ]
