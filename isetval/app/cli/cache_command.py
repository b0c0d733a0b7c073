"""``isetval cache``: where results that can be made again are kept, how much there is, and throwing it away."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from isetval.app.cli.console import Console
from isetval.app.cli.outcome import FINE, Outcome
from isetval.app.cli.tables import text_table

MEGABYTE = 1e6


def register(commands: Any, common: argparse.ArgumentParser) -> None:
    """The command and its options."""
    p = commands.add_parser("cache", parents=[common], help="what is kept between runs: size, clear", description=cache.__doc__)
    p.add_argument("action", nargs="?", choices=("size", "clear"), default="size", help="default: %(default)s")
    p.add_argument(
        "--keep-mb", type=float, default=0.0, metavar="MB", help="of clear: keep what was used last, up to so many megabytes"
    )
    p.set_defaults(handler=cache, writes_result=False, tells_dry_run=True)


def cache(args: argparse.Namespace, console: Console) -> Outcome:
    """Show the cache's folder and size, or clear it; nothing in it is lost for good, it is only computed again."""
    from isetval.core.cache import cache_folder, prune

    folder = cache_folder()
    parts = _sizes(folder)
    whole = sum(size for size, _ in parts.values())
    lines = [f"{folder}: {whole / MEGABYTE:.1f} MB"]
    freed = 0
    if args.action == "clear":
        if not args.dry_run:
            freed = prune(folder, max_bytes=round(args.keep_mb * MEGABYTE))
        lines = [f"{folder}: {freed / MEGABYTE:.1f} of {whole / MEGABYTE:.1f} MB freed"]
    elif parts:
        rows = [(name, count, f"{size / MEGABYTE:.1f}") for name, (size, count) in sorted(parts.items())]
        lines += text_table(("folder", "files", "MB"), rows)
    result = {
        "kind": "cache",
        "folder": str(folder),
        "bytes": whole,
        "freed_bytes": freed,
        "parts": {name: {"bytes": size, "files": count} for name, (size, count) in parts.items()},
    }
    return Outcome(result, lines, FINE)


def _sizes(folder: Path) -> dict[str, tuple[int, int]]:
    """Bytes and number of the files in each folder of the cache."""
    out: dict[str, tuple[int, int]] = {}
    for path in folder.rglob("*") if folder.is_dir() else ():
        if path.is_file():
            parts = path.relative_to(folder).parts
            name = parts[0] if len(parts) > 1 else "."
            size, count = out.get(name, (0, 0))
            out[name] = (size + path.stat().st_size, count + 1)
    return out
