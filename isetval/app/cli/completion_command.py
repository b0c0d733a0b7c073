"""``isetval completion SHELL``: the script that lets a shell complete commands, options and files."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from isetval.app.cli.console import Console
from isetval.app.cli.outcome import FINE, Outcome

SHELLS = ("bash", "zsh", "tcsh")
PATHS = ("PATH", "MODEL", "MODEL2", "CAMPAIGN", "PLAN", "FILE", "FOLDER", "DIR", "IMAGE", "RESULT")  # metavars that name files
WHERE = {
    "bash": "isetval completion bash -o ~/.local/share/bash-completion/completions/isetval",
    "zsh": "isetval completion zsh -o ~/.zfunc/_isetval   (with fpath+=~/.zfunc before compinit in ~/.zshrc)",
    "tcsh": "isetval completion tcsh -o /etc/profile.d/isetval.completion.csh",
}


def register(commands: Any, common: argparse.ArgumentParser) -> None:
    """The command."""
    p = commands.add_parser(
        "completion",
        parents=[common],
        help="completion for bash, zsh, tcsh",
        description=completion.__doc__,
        epilog="where it goes:\n  " + "\n  ".join(WHERE.values()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    p.add_argument("shell", choices=SHELLS)
    p.set_defaults(handler=completion, writes_result=False, tells_dry_run=True)


def completion(args: argparse.Namespace, console: Console) -> Outcome:
    """Print (or write with -o) the script that completes commands, options and files in a shell."""
    import shtab

    from isetval.core.writing import write_whole

    _complete_files(args.parser, shtab.FILE)
    script = shtab.complete(args.parser, shell=args.shell)
    result = {"kind": "completion", "shell": args.shell, "script": script}
    if args.output is None:
        if not args.json:
            sys.stdout.write(script)  # as it is: a shell reads it
        return Outcome(result, (), FINE)
    if not args.dry_run:
        write_whole(args.output, script)
    return Outcome(result, [f"completion for {args.shell}: {args.output}"], FINE)


def _complete_files(parser: argparse.ArgumentParser, how: Any) -> None:
    """Mark every argument that is a path, of all commands."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                _complete_files(command, how)
        elif action.type is Path or action.metavar in PATHS:
            action.complete = how  # type: ignore[attr-defined]  # where shtab looks for it
