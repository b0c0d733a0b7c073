"""Templates of the pages, with the style and script that each carries along."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def rendered(template: str, *, script_name: str = "report.js", **content: Any) -> str:
    """A page that needs nothing beside itself."""
    from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
    from markupsafe import Markup

    environment = Environment(
        loader=PackageLoader("isetval.app.report"),
        autoescape=select_autoescape(),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    folder = Path(__file__).parent / "templates"
    style, script = (Markup((folder / name).read_text(encoding="utf-8")) for name in ("report.css", script_name))
    return environment.get_template(template).render(content, style=style, script=script)
