"""Regions of a picture that a person drew: ``[target.NAME]`` tables of edges and patches as in a campaign, and ``[[line]]``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from isetval.core.errors import InputError
from isetval.core.scene import ChartTarget, EdgeTarget
from isetval.core.sensor import RoiLike
from isetval.core.toml import check_keys, numbers, read_toml, text
from isetval.files.target_file import read_target

Point = tuple[float, float]


@dataclass(frozen=True)
class Regions:
    """Named regions of edges, boxes of patches, ends (row, col) of lines."""

    edges: tuple[tuple[str, RoiLike], ...]
    patches: tuple[tuple[str, RoiLike], ...]
    lines: tuple[tuple[str, Point, Point], ...]


def read_regions(path: Path | str) -> Regions:
    """Read a file that `isetval roi` made, or the targets of a ``campaign.toml``.

    Raises
    ------
    InputError
        For an unknown kind of target, a bad region, or a file without any.
    """
    path = Path(path)
    table = read_toml(path)
    targets = [read_target(name, entry, path) for name, entry in table.get("target", {}).items()]
    edges = tuple((t.name, t.roi) for t in targets if isinstance(t, EdgeTarget) and t.roi is not None)
    patches = tuple((patch.name, patch.box) for t in targets if isinstance(t, ChartTarget) for patch in t.patches)
    lines = []
    for i, entry in enumerate(table.get("line", []), 1):
        where = f"{path}: [[line]] number {i}"
        entry = check_keys(entry, where, known=("name", "from", "to"), needed=("from", "to"))
        ends = [numbers(entry, key, where, lengths=(2,)) for key in ("from", "to")]
        lines.append((text(entry, "name", where, f"line_{i}"), (ends[0][0], ends[0][1]), (ends[1][0], ends[1][1])))
    if not (edges or patches or lines):
        raise InputError(f"{path}: holds no region; draw some with isetval roi IMAGE -o page.html and download them")
    return Regions(edges, patches, tuple(lines))
