"""What the scripts share: where the data are, a folder to work in, a claim of the table, and how a script is run."""

from __future__ import annotations

import argparse
import csv
import importlib
import shutil
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
DATA = ROOT.parent / "shared" / "data" / "pixel4a"
PRINTED = tomllib.loads((HERE / "printed.toml").read_text())
MEASURED, PUBLISHED, OURS, DESIGN = "tab:blue", "tab:red", "black", "tab:gray"
"""Colours of the curves in every figure: measured, published simulation, ours, the lens design."""


@dataclass(frozen=True)
class Claim:
    """One line of the table: what the paper says, what was measured, what both simulations give, and what was missing.

    ``ours`` has a ``sigma`` (None: it is no estimate); ``target`` says in words what was to be reached and ``met`` whether it was
    (None: no target).
    """

    claim: str
    published: str
    measured: str
    ours: str
    missing: str
    sure: str
    target: str = ""
    met: bool | None = None
    numbers: dict[str, float] = field(default_factory=dict)

    def plain(self) -> dict[str, float | bool | None]:
        """What JSON can hold of the verdict and the numbers."""
        return {"met": None if self.met is None else bool(self.met)} | {k: float(v) for k, v in self.numbers.items()}


@dataclass(frozen=True, eq=False)
class Result:
    """What one script found."""

    key: str
    title: str
    claims: tuple[Claim, ...]
    figure: Figure | None
    caption: str
    remarks: tuple[str, ...] = ()
    ladder: tuple[tuple[str, ...], ...] = ()
    seconds: float = 0.0


def csv_rows(path: Path) -> list[dict[str, str]]:
    """The rows of a table of the data."""
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def columns(rows: Iterable[dict[str, str]], *names: str) -> tuple[np.ndarray[Any, Any], ...]:
    """Columns of rows in which all of them hold a number."""
    kept = [[float(row[name]) for name in names] for row in rows if all(row[name] for name in names)]
    return tuple(np.array(kept).T)


def write_rows(path: Path, names: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """A table beside a campaign."""
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(names)
        writer.writerows(rows)


def qe_file(data: Path, out: Path, *, corrected: bool = True) -> None:
    """The published quantum efficiency under the column names that a camera model needs."""
    name = "sensor_qe_corrected.csv" if corrected else "sensor_qe_nominal_derived.csv"
    lines = (data / name).read_text().splitlines()
    out.write_text("\n".join(["wavelength_nm,R,G,B", *lines[1:]]) + "\n")


def laboratory(template: str, work: Path) -> Path:
    """A folder to work in, with the camera models and campaigns of a template (their curves come from the data)."""
    folder = work / template
    folder.mkdir(parents=True, exist_ok=True)
    for file in sorted((HERE / template).glob("*.toml")):
        shutil.copy(file, folder)
    return folder


def crossing(position: np.ndarray[Any, Any], value: np.ndarray[Any, Any], level: float = 0.5) -> float:
    """Where a falling curve first crosses a level, on straight lines between its points; nan where it does not."""
    below = np.flatnonzero(value < level)
    if not below.size or below[0] == 0:
        return float("nan")
    i = int(below[0])
    return float(np.interp(level, [value[i], value[i - 1]], [position[i], position[i - 1]]))


def rms(values: np.ndarray[Any, Any]) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


Script = Callable[[Path, Path], Result]


def timed(script: Script, data: Path, work: Path) -> Result:
    """A script's result with the time that it took."""
    start = time.perf_counter()
    found = script(data, work)
    return replace(found, seconds=time.perf_counter() - start)


def result_of(name: str, data: Path) -> Result:
    """The result of the script of this name, from a folder of its own; here, so that other processes find it."""
    with tempfile.TemporaryDirectory() as folder:
        return timed(importlib.import_module(f"analyses.paper.{name}").run, data, Path(folder))


def main(script: Script, words: str) -> None:
    """Run one script from the shell: print its lines, write its figure where asked."""
    parser = argparse.ArgumentParser(description=words)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the published data (default: ../shared/data/pixel4a)")
    parser.add_argument("--figure", type=Path, help="write the figure to this file (.png, .svg, .pdf)")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = timed(script, args.data, Path(folder))
    print_result(found)
    if args.figure and found.figure:
        found.figure.savefig(args.figure)


def print_result(found: Result) -> None:
    """The claims of one result, and what else is to be said."""
    print(f"\n{found.title}  ({found.seconds:.0f} s)")
    for claim in found.claims:
        target = "" if claim.met is None else f"  [target {claim.target}: {'met' if claim.met else 'NOT met'}]"
        print(
            f"  {claim.claim}\n    measured {claim.measured} | published simulation {claim.published} | ours {claim.ours}{target}"
        )
        print(f"    missing: {claim.missing}; {claim.sure}")
    for line in found.ladder:
        print("    " + " | ".join(line))
    for remark in found.remarks:
        print(f"  - {remark}")
