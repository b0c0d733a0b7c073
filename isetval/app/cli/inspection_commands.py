"""``effects``, ``doctor``, ``lens audit``, ``report``, ``rerun``."""

from __future__ import annotations

import argparse
import difflib
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from isetval.app.cli.console import Console
from isetval.app.cli.outcome import FINE, MISSING_PART, OUTSIDE_LIMITS, Outcome
from isetval.app.cli.tables import text_table
from isetval.core.errors import InputError


def register(commands: Any, common: argparse.ArgumentParser) -> None:
    """The commands and their options."""
    p = commands.add_parser(
        "effects", parents=[common], help="the catalogue with units and equations", description=effects.__doc__
    )
    p.add_argument(
        "names", nargs="*", metavar="EFFECT", help="only these, with their text; or words to search names and texts for"
    )
    p.add_argument(
        "--stage", default="electronics", help="of new: optics, pixel, exposure, electronics or file (default: %(default)s)"
    )
    p.set_defaults(handler=effects, writes_result=True, tells_dry_run=True)
    p = commands.add_parser("doctor", parents=[common], help="what is installed, which renderer is used and why")
    p.set_defaults(handler=doctor, writes_result=True)
    lens = commands.add_parser("lens", help="lens files: audit").add_subparsers(metavar="ACTION", required=True)
    p = lens.add_parser(
        "audit", parents=[common], help="contradictions of a lens file; -o NAME.html, .pdf, .png", description=lens_audit.__doc__
    )
    p.add_argument("file", type=Path, metavar="FILE", help="ray-transfer lens (JSON)")
    p.add_argument("--f-number", type=float, help="the f-number that the lens is said to have")
    p.add_argument("--sensor-diagonal", type=float, metavar="MM", help="diagonal of the sensor in mm")
    p.add_argument("--film", type=float, metavar="MM", help="film to rear vertex, where f-number and fall-off are taken")
    p.add_argument(
        "--focus",
        action="append",
        type=_focus_pair,
        default=[],
        metavar="FILM_MM=OBJECT_M",
        help="a film distance that is said to focus an object (front vertex to object); may be given several times",
    )
    p.add_argument("--open", action="store_true", help="open the page that -o wrote")
    p.set_defaults(handler=lens_audit, writes_result=True, suffixes=(".html", ".pdf", ".png"))
    p = commands.add_parser("report", parents=[common], help="results -> one self-contained page", description=report.__doc__)
    p.add_argument("results", nargs="+", metavar="RESULT", type=Path, help="JSON results of measure, compare, diagnose, demo")
    p.add_argument("--open", action="store_true", help="open the page")
    p.set_defaults(handler=report, writes_result=False, suffixes=(".html", ".htm"))
    p = commands.add_parser("rerun", parents=[common], help="the same numbers again, or what moved", description=rerun.__doc__)
    p.add_argument("result", metavar="RESULT", type=Path, help="JSON result written with -o")
    p.add_argument(
        "--rtol", type=float, default=1e-9, help="largest relative difference that counts as equal (default %(default)g)"
    )
    p.add_argument("--yes", action="store_true", help="run the command in the result without asking")
    p.set_defaults(handler=rerun, writes_result=True)


def effects(args: argparse.Namespace, console: Console) -> Outcome:
    """List the catalogue of physical effects: name, stage, place in it, parameters with unit and bounds, equation, source.

    ``isetval effects new NAME`` writes NAME.py and test_NAME.py into this folder: an effect that works, to be made yours.
    """
    from isetval.effects import catalogue

    if args.names[:1] == ["new"] and len(args.names) == 2:
        return _new_effect(args)
    known = {name: _effect_row(cls) for name, cls in catalogue().items()}
    if not args.names:
        title = f"# {len(known)} effects along the light path (text of one: isetval effects NAME; search: isetval effects WORD)"
        rows, lines = list(known.values()), [title, *_effect_table(known.values())]
    elif all(name in known for name in args.names):
        rows = [known[name] for name in args.names]
        lines = [line for row in rows for line in _effect_text(row)]
    else:
        rows = [row for row in known.values() if any(_speaks_of(row, word) for word in args.names)]
        lines = [f"# {len(rows)} effects that speak of {' or '.join(args.names)}", *_effect_table(rows)]
        if not rows:
            raise _unknown_effect(args.names, known)
    return Outcome({"kind": "effects", "effects": rows}, lines, FINE, {}, _flat(rows))


def _new_effect(args: argparse.Namespace) -> Outcome:
    from isetval.app.cli.effect_scaffold import scaffold

    effect, test = scaffold(args.names[1], stage=args.stage, folder=Path(), write=not args.dry_run)
    lines = [
        f"{effect}: an effect that works; change its text, equation and apply",
        f"{test}: its test: python -m pytest {test}",
        f'to use it, write plugin = "{effect}" at the top of camera.toml and add --allow-plugin, or name its class in the',
        "entry-point group isetval.effects of a package of your own",
    ]
    return Outcome({"kind": "effects new", "effect": str(effect), "test": str(test)}, lines, FINE)


def _effect_table(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    body = [
        (r["stage"], f"{r['order']:g}", r["name"], "; ".join(_parameter_words(p) for p in r["parameters"]), r["equation"])
        for r in rows
    ]
    return text_table(("stage", "order", "effect", "parameters", "equation"), body)


def _speaks_of(row: Mapping[str, Any], word: str) -> bool:
    """Whether a word stands in an effect's name, text or equation."""
    texts = (row["name"], row["text"], row["equation"], *(p["doc"] for p in row["parameters"]))
    return any(word.lower() in text.lower() for text in texts)


def _unknown_effect(words: Sequence[str], known: Iterable[str]) -> InputError:
    near = [name for word in words for name in difflib.get_close_matches(word, list(known), n=3, cutoff=0.4)]
    hint = f"; near it: {', '.join(near)}" if near else ""
    return InputError(f"effects: none speaks of {' or '.join(words)}{hint} (all: isetval effects)")


def _effect_row(cls: Any) -> dict[str, Any]:
    import inspect

    return {
        "name": cls.name,
        "stage": cls.stage,
        "order": cls.order,
        "acts_on": cls.acts_on,
        "gives": cls.gives,
        "candidate": cls.candidate,
        "random": cls.random,
        "equation": cls.equation,
        "reference": cls.reference,
        "absent": cls.absent,
        "imitated_by": list(cls.imitated_by),
        "free_along": cls.free.axis if cls.free is not None else None,
        "files": list(cls.files()),
        "parameters": [vars(p) for p in cls.parameters()],
        "text": inspect.cleandoc(cls.__doc__ or ""),
    }


def _parameter_words(p: dict[str, Any]) -> str:
    return f"{p['name']} [{p['unit']}]"


def _effect_text(row: dict[str, Any]) -> list[str]:
    lines = [f"# {row['name']} ({row['stage']}, place {row['order']:g})", *(f"  {line}" for line in row["text"].splitlines())]
    lines += [f"  equation: {row['equation']}", f"  source: {row['reference']}"]
    if row["free_along"]:
        lines.append(f"  other forms: any smooth one along the {row['free_along']}")
    if row["absent"]:
        lines.append(f"  does not occur in: {row['absent']}")
    if row["imitated_by"]:
        lines.append(f"  imitated by: {', '.join(row['imitated_by'])}")
    for p in row["parameters"]:
        scale = f", plausible scale {p['tau']:g}" if p["tau"] is not None else ""
        lines.append(f"  {p['name']} [{p['unit']}], {p['low']:g} to {p['high']:g}, no effect at {p['null']:g}{scale}: {p['doc']}")
    return lines


def _flat(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    head = ("name", "stage", "equation", "reference")
    return [{"effect": r["name"], **{k: r[k] for k in head[1:]}, **p} for r in rows for p in r["parameters"] or [{"name": ""}]]


def doctor(args: argparse.Namespace, console: Console) -> Outcome:
    """Examine the installation; exit code 4 if a part that is needed is missing."""
    from isetval.app.doctor import examine

    console.say("trying renderers in child processes")
    checks, choice = examine()
    marks = {"ok": "ok", "absent": "-", "broken": "MISSING"}
    lines = text_table(("part", "", "found"), [(c.part, marks[c.state], c.found) for c in checks], indent=0)
    for probe in choice.get("probes", ()):
        state = "passed" if probe["passed"] else "failed"
        tried = f"{probe['variant']} {probe['library']}".rstrip()
        lines.append(f"  tried {tried}: {state}: {probe['message']}")
    lines += [f"remedy for {c.part}: {c.remedy}" for c in checks if c.remedy]
    code = MISSING_PART if any(c.state == "broken" for c in checks) else FINE
    return Outcome({"kind": "doctor", "checks": [vars(c) for c in checks], "mitsuba": choice}, lines, code)


def _focus_pair(text: str) -> tuple[float, float]:
    """``FILM_MM=OBJECT_M`` as two positive lengths; ``inf`` is a far object."""
    film, equals, distance = text.partition("=")
    try:
        pair = float(film), float(distance)
    except ValueError:
        pair = (math.nan, math.nan)
    if not equals or not (0 < pair[0] < math.inf and pair[1] > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is no FILM_MM=OBJECT_M, such as 0.52=0.5")
    return pair


def lens_audit(args: argparse.Namespace, console: Console) -> Outcome:
    """Print what a lens file holds (f-number, fall-off, chief rays, focus) and flag where it contradicts itself.

    With -o NAME.png its curves are drawn, with -o NAME.html or .pdf also focus, spots, MTF and depth of field.
    """
    from isetval.core.cache import file_hash
    from isetval.lens import audit_file

    digest = file_hash(args.file)
    console.say(f"tracing rays through {args.file}")
    found = audit_file(
        args.file,
        stated_f_number=args.f_number,
        stated_focus=dict(args.focus),
        sensor_diagonal_mm=args.sensor_diagonal,
        film_mm=args.film,
    )

    def page(suffix: str, result: Mapping[str, Any]) -> bytes:
        from isetval.app.plots.lens import lens_figures
        from isetval.app.plots.panels import figure_bytes, pdf_bytes

        if suffix == ".html":
            from isetval.app.report.lens_page import lens_html

            return lens_html(result, found, args.file).encode()
        figures = lens_figures(args.file, found, whole=suffix == ".pdf")
        return pdf_bytes(figures) if suffix == ".pdf" else figure_bytes(figures[0], "png")

    result = {"kind": "lens audit", **found.to_json()}
    return Outcome(result, found.lines(), FINE, {str(args.file): digest}, page=page)


def report(args: argparse.Namespace, console: Console) -> Outcome:
    """Draw one page from results: does it match, where not, what is missing, how the error fell."""
    from isetval.app.report import write_report
    from isetval.core.cache import file_hash
    from isetval.files.result_file import read_result

    if args.output is None:
        raise InputError("report needs -o PAGE.html: the file to write")
    results = [read_result(path, filled=True) for path in args.results]
    console.say("drawing the report")
    write_report(results, args.output)
    lines = [f"report: {Path(args.output).resolve()} ({os.path.getsize(args.output) / 1e3:.0f} kB, opens without network)"]
    inputs = {str(path): file_hash(path) for path in args.results}
    return Outcome({"kind": "report", "report": args.output}, lines, FINE, inputs)


def rerun(args: argparse.Namespace, console: Console) -> Outcome:
    """Run the command behind a result again and list every number that moved (exit code 1 if any did)."""
    from isetval.app.rerun import command_of, rerun_result
    from isetval.core.cache import file_hash
    from isetval.core.jsonable import plain
    from isetval.files.result_file import read_result

    stored = read_result(args.result)
    words = command_of(stored)
    again = _parsed_again(args.parser, words)
    _consent(words, args, console)
    console.say(f"running the command of {args.result} again")

    def run() -> tuple[dict[str, Any], dict[str, str]]:
        outcome: Outcome = again.handler(again, console)
        return plain(outcome.result), dict(outcome.inputs)

    found = rerun_result(stored, run, rtol=args.rtol)
    code = OUTSIDE_LIMITS if found.moved else FINE
    result = {
        "kind": "rerun",
        "command": list(found.command),
        "moved": [vars(m) for m in found.moved],
        "compared": found.compared,
    }
    result |= {"changed_inputs": list(found.changed_inputs), "changed_versions": dict(found.changed_versions)}
    return Outcome(result, found.lines(), code, {str(args.result): file_hash(args.result)})


def _parsed_again(parser: argparse.ArgumentParser, words: list[str]) -> argparse.Namespace:
    """The command of a result as the command line understands it, with nothing to write."""
    import contextlib
    import io

    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            args = parser.parse_args(words)
    except SystemExit:
        reason = said.getvalue().strip().rpartition("error: ")[2] or "it makes no numbers"
        raise InputError(f"the result's command is not understood: {_shown(words)}: {reason}") from None
    args.output = None
    args.parser = parser
    args.fresh = True  # measured again, not looked up in a store
    return args


def _consent(words: list[str], args: argparse.Namespace, console: Console) -> None:
    """The command in a file is whoever made the file's: it is shown, and run when a person (or ``--yes``) says so."""
    if args.yes:
        return
    asked = f"{args.result} holds this command; it opens the files named in it, and writes none:\n  {_shown(words)}"
    if not console.can_ask():
        raise InputError(f"{asked}\nadd --yes to run it")
    if not console.ask(f"{asked}\nrun it? [y/N] "):
        raise InputError(f"{args.result}: its command was not run")


def _shown(words: list[str]) -> str:
    """A command line as a shell would take it; characters that a terminal would act on are escaped."""
    import shlex

    text = shlex.join(["isetval", *words])
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
