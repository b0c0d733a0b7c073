"""Tables in plain text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def text_table(header: Sequence[str], rows: Iterable[Sequence[object]], *, indent: int = 2) -> list[str]:
    """Aligned columns; cells that look like numbers to the right."""
    cells = [list(map(str, header)), *[["" if c is None else str(c) for c in row] for row in rows]]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    right = [all(_numeric(row[i]) for row in cells[1:]) and len(cells) > 1 for i in range(len(header))]
    lines = []
    for row in cells:
        parts = [c.rjust(w) if r else c.ljust(w) for c, w, r in zip(row, widths, right, strict=True)]
        lines.append(" " * indent + "  ".join(parts).rstrip())
    return lines


def _numeric(cell: str) -> bool:
    return not cell or cell[0] in "+-.0123456789" or cell == "-"
