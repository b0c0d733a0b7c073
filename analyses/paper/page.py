"""The page: every figure, every claim, one table."""

from __future__ import annotations

import base64
from pathlib import Path

from analyses.paper.common import HERE, Result
from isetval import __version__
from isetval.app.plots.panels import figure_bytes


def write_page(path: Path, results: list[Result]) -> None:
    """One file that needs nothing beside itself; written whole or not at all."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

    environment = Environment(
        loader=FileSystemLoader(HERE),
        autoescape=select_autoescape(),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # pictures of curves, not the curves: the data stay their owners'
    pictures = {r.key: base64.b64encode(figure_bytes(r.figure, "png")).decode() for r in results if r.figure}
    judged = [c for r in results for c in r.claims if c.met is not None]
    text = environment.get_template("page.html").render(
        results=results,
        pictures=pictures,
        met=sum(bool(c.met) for c in judged),
        judged=len(judged),
        version=__version__,
    )
    part = path.with_suffix(".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)
