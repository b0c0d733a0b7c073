"""The command line: a thin shell over functions, one module for each group of commands."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from isetval.app.cli.console import Console
from isetval.app.cli.outcome import BAD_INPUT, FINE, INTERNAL, MEASURED_SUFFIXES, MISSING_PART, Outcome
from isetval.core.jsonable import plain

__all__ = ["main"]

COMPUTING = ("measure", "simulate", "compare", "identify", "diagnose", "rerun", "demo", "lens_audit")
"""Commands whose numbers go through linear algebra."""
RESULT_SUFFIXES = (".json", ".csv")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code (0 fine, 1 outside limits, 2 usage, 3 bad input, 4 missing part)."""
    from isetval.app.cli.parser import build_parser

    words = list(sys.argv[1:] if argv is None else argv)
    parser = build_parser()
    try:
        args = parser.parse_args(words)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 2
    args.parser = parser
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a console without Greek letters gets their numbers, not a broken command
            stream.reconfigure(errors="backslashreplace")
    console = Console(json=args.json, quiet=args.quiet, verbose=args.verbose)
    try:
        with console:
            return _run(args, words, console)
    except BrokenPipeError:
        with contextlib.suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FINE
    except KeyboardInterrupt:
        console.error("interrupted; nothing half-written was left behind")
        return 130
    except Exception as error:
        return _explained(error, console, verbose=args.verbose)


def _explained(error: Exception, console: Console, *, verbose: bool) -> int:
    from isetval.core.errors import InputError, MissingPartError

    if verbose and not isinstance(error, InputError | MissingPartError):
        import traceback

        traceback.print_exc()
    if isinstance(error, InputError):
        console.error(str(error))
        return BAD_INPUT
    if isinstance(error, MissingPartError):
        console.error(str(error))
        return MISSING_PART
    if isinstance(error, OSError) and error.filename is not None:
        console.error(f"{error.filename}: {error.strerror}; check that the path exists and may be read or written")
        return BAD_INPUT
    if isinstance(error, MemoryError):
        console.error("the machine ran out of memory; give fewer files at once, or smaller windows")
        return BAD_INPUT
    console.error(f"internal error: {type(error).__name__}: {error}; please report it with the command (-v shows where)")
    return INTERNAL


def _run(args: argparse.Namespace, words: list[str], console: Console) -> int:
    import warnings

    if not args.verbose:
        warnings.simplefilter("ignore")
    _check_output(args.output, (*RESULT_SUFFIXES, *args.suffixes) if args.writes_result else args.suffixes)
    with _plugins(args.allow_plugin):
        outcome = _outcome(args, console)
    if args.dry_run:
        console.show(outcome.lines)
        _print_json(args, outcome.result)
        return outcome.code
    result = _with_provenance(outcome, words)
    if args.output is not None and args.writes_result:
        _write(args.output, result, outcome)
        console.note(f"written: {args.output}")
    console.show(outcome.lines)
    _print_json(args, result)
    if getattr(args, "open", False):
        _open(outcome.result.get("page") or outcome.result.get("report") or args.output)
    return outcome.code


def _plugins(allow: bool) -> contextlib.AbstractContextManager[None]:
    """Where a person allowed it, model files may run the programs that they name."""
    if not allow:
        return contextlib.nullcontext()
    from isetval.camera.plugins import plugins_allowed

    return plugins_allowed()


def _outcome(args: argparse.Namespace, console: Console) -> Outcome:
    """What the command's handler gives, or what it would do."""
    if args.dry_run and not getattr(args, "tells_dry_run", False):
        from isetval.app.cli.dry_run import dry_run

        return dry_run(args, console)
    if args.handler.__name__ not in COMPUTING:
        outcome: Outcome = args.handler(args, console)
        return outcome
    from isetval.core.threads import one_blas_thread

    with one_blas_thread():  # with more of them sums take another order, and results move with the number of cores
        outcome = args.handler(args, console)
    return outcome


def _print_json(args: argparse.Namespace, result: Mapping[str, Any]) -> None:
    if args.json:
        import json

        print(json.dumps(plain(result), indent=1, allow_nan=False))
        sys.stdout.flush()


def _open(page: str | None) -> None:
    """Show a page in the person's browser."""
    if page is not None:
        import webbrowser

        webbrowser.open(Path(page).resolve().as_uri())


def _with_provenance(outcome: Outcome, words: list[str]) -> dict[str, Any]:
    from isetval.app.provenance import provenance

    result: dict[str, Any] = plain(outcome.result)
    return result | {"provenance": plain(provenance(words, outcome.inputs))}


def _check_output(output: str | None, suffixes: Sequence[str]) -> None:
    """Refuse a place that cannot be written, or a kind of file that the command does not make, before any work is done."""
    from isetval.core.errors import InputError

    if output is None:
        return
    if suffixes and not output.lower().endswith(tuple(suffixes)):
        named = Path(output).suffix or "without a suffix"
        raise InputError(
            f"{output}: a file {named} is not what this command writes; name one that ends in {' or '.join(suffixes)}"
        )
    folder = Path(output).resolve().parent
    if not folder.is_dir():
        raise InputError(f"{output}: the folder {folder} does not exist; make it, or write elsewhere")
    if not os.access(folder, os.W_OK):
        raise InputError(f"{output}: the folder {folder} may not be written; write elsewhere")


def _write(output: str, result: dict[str, Any], outcome: Outcome) -> None:
    from isetval.core.writing import write_whole

    if output.lower().endswith(".csv"):
        write_whole(output, _csv(outcome))
        return
    suffix = Path(output).suffix.lower()
    if outcome.page is not None and suffix in MEASURED_SUFFIXES:
        write_whole(output, outcome.page(suffix, result))
        return
    import json

    write_whole(output, json.dumps(result, indent=1, allow_nan=False) + "\n")


def _csv(outcome: Outcome) -> str:
    import csv
    import io

    from isetval.core.errors import InputError

    if not outcome.table:
        raise InputError("this command has no table to write as CSV; name a .json file instead")
    names = list(dict.fromkeys(name for row in outcome.table for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(plain(list(outcome.table)))
    return text.getvalue()
