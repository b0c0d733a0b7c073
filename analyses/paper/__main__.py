"""All results of the paper, the whole table at the end: `python -m analyses.paper [--json FILE] [--data DIR] [--page FILE]`."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from analyses.paper.common import DATA, ROOT, Result, print_result, result_of
from analyses.paper.page import write_page

SCRIPTS = (
    "lens",
    "relative_illumination",
    "edges",
    "noise",
    "conversion_gain",
    "spectral_qe",
    "inter_reflections",
    "color",
    "pictures",
)
"""In the order of the page."""


def table(results: list[Result]) -> list[dict[str, object]]:
    """The rows of the whole table."""
    return [
        {"result": r.title, **{k: v for k, v in vars(claim).items() if k not in ("met", "numbers")}, **claim.plain()}
        for r in results
        for claim in r.claims
    ]


def results_of(names: tuple[str, ...], data: Path, jobs: int) -> list[Result]:
    """The results in order, each printed when all before it are there; ``jobs`` scripts at a time."""
    results = []
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        for found in pool.map(partial(result_of, data=data), names):
            print_result(found)
            results.append(found)
    return results


def main() -> int:
    """Run the scripts, print the table, write the page."""
    parser = argparse.ArgumentParser(prog="python -m analyses.paper", description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the published data (default: ../shared/data/pixel4a)")
    parser.add_argument("--json", action="store_true", help="print the table as JSON on stdout, all words on stderr")
    parser.add_argument(
        "--page", type=Path, default=ROOT / "reports" / "paper.html", help="the page (default: reports/paper.html)"
    )
    parser.add_argument("--only", nargs="*", choices=SCRIPTS, help="only these results (no page unless --page is stated)")
    parser.add_argument("-j", "--jobs", type=int, default=2, help="scripts at a time (default: %(default)s)")
    args = parser.parse_args()
    if not (args.data / "measured").is_dir():
        print(f"{args.data}: no published data there (folder measured/ missing); name their folder with --data", file=sys.stderr)
        return 3
    out = sys.stdout
    if args.json:
        sys.stdout = sys.stderr
    start = time.perf_counter()
    results = results_of(tuple(args.only or SCRIPTS), args.data, args.jobs)
    rows = table(results)
    seconds = time.perf_counter() - start
    print(f"\n{'claim':76s} | {'published':>16s} | {'measured':>16s} | {'ours':>16s} | target")
    for row in rows:
        met = {None: "", True: "met", False: "NOT met"}[row["met"]]  # type: ignore[index]
        cells = (
            str(row[k])[:width].ljust(width) for k, width in (("claim", 76), ("published", 16), ("measured", 16), ("ours", 16))
        )
        print(" | ".join(cells), "|", met)
    print(f"{seconds:.0f} s")
    if not args.only:
        write_page(args.page, results)
        print(f"page: {args.page}")
    if args.json:
        json.dump(rows, out, indent=1)
        out.write("\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
