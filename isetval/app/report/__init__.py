"""One self-contained page from results: no server, no network, opens in five years."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from isetval.core.errors import InputError

__all__ = ["report_html", "write_report"]


def report_html(results: Sequence[Mapping[str, Any]]) -> str:
    """The page as text.

    Parameters
    ----------
    results : sequence of mapping
        Results of measure, compare, diagnose or demo as the command line writes them.

    Raises
    ------
    InputError
        If none of the results can be drawn.
    """
    from jinja2 import TemplateError

    from isetval.app.report.content import page_content
    from isetval.app.report.pages import rendered

    known = [r for r in results if r.get("kind") == "demo" or "verdict" in r or "ladder" in r or r.get("kind") == "measure"]
    if not known:
        kinds = ", ".join(str(r.get("kind", "unknown")) for r in results) or "nothing"
        raise InputError(f"a report needs results of measure, compare, diagnose or demo; found {kinds}")
    try:
        return rendered("report.html", **page_content(known))
    except InputError:
        raise
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, TemplateError) as error:
        raise InputError(
            f"the results cannot be drawn ({type(error).__name__}: {error}): their numbers or names do not belong together; "
            "make them again with this version of isetval"
        ) from None


def write_report(results: Sequence[Mapping[str, Any]], path: Path | str) -> Path:
    """Write the page, whole or not at all.

    Raises
    ------
    InputError
        If nothing can be drawn or the file cannot be written.
    """
    from isetval.core.writing import write_whole

    write_whole(path, report_html(results))
    return Path(path)
