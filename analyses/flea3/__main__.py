"""From the folder to the page: `python -m analyses.flea3 [--data FOLDER] [--work FOLDER] [--quick]`."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import isetval
from analyses.flea3 import darks, lens, levels
from analyses.flea3.common import DATA, MODEL, ROOT, laboratory
from analyses.flea3.page import write_page
from analyses.flea3.statements import statements
from analyses.flea3.verdict import verdict


def run(data: Path, work: Path, *, quick: bool, diagnose: bool = False, say: Any = print) -> dict[str, Any]:
    """Everything that the page shows."""
    lab = laboratory(data, work)
    model = isetval.load_model(MODEL)
    rows = {"charts, second visit": levels.rows_of(lab.charts), "disks, first visit": levels.rows_of(lab.disks)}
    out: dict[str, Any] = {"linearity": {name: levels.linearity(r) for name, r in rows.items()}}
    name = "charts, second visit"
    out["spectral"] = levels.spectral(rows[name], out["linearity"][name], lab.charts, model.sampled_as(lab.charts.sensor))
    out["glare"] = levels.glare(rows[name], out["linearity"][name], lab.charts)
    out["darks"] = {"first visit": darks.dark_pixels(lab.disks), "second visit (shrunk)": darks.dark_pixels(lab.charts)}
    out["lens"] = lens.color_errors(lab.disks)
    if not quick:
        out["verdict"] = verdict(lab, model, *rows.values(), diagnose=diagnose, say=say)
    out["statements"] = statements(out)
    return out


def main() -> int:
    """Run it, print what can be said, write the page."""
    parser = argparse.ArgumentParser(prog="python -m analyses.flea3", description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the pictures (default: %(default)s)")
    parser.add_argument("--work", type=Path, help="folder for the drafted campaigns, kept (default: a temporary one)")
    parser.add_argument("--page", type=Path, default=ROOT / "reports" / "flea3.html", help="the page (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="what is measured, without comparison and diagnosis")
    parser.add_argument("--diagnose", action="store_true", help="ask the catalogue for the missing effect as well (half an hour)")
    options = parser.parse_args()
    if not options.data.is_dir():
        print(f"{options.data}: the pictures are not there; name their folder with --data", file=sys.stderr)
        return 3
    with tempfile.TemporaryDirectory() as temporary:
        work, words = options.work or Path(temporary), lambda s: print(s, file=sys.stderr)
        result = run(options.data, work, quick=options.quick, diagnose=options.diagnose, say=words)
    for what, sure, test in result["statements"]:
        print(f"- {what}\n    sure: {sure}\n    test: {test}")
    options.page.with_suffix(".json").write_text(json.dumps(result, indent=1, default=float) + "\n")
    write_page(options.page, result)
    print(f"page: {options.page}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
