"""The README's numbers and their picture: ``isetval demo > demo.txt && python docs/make_ladder.py demo.txt``.

Without a file the picture is drawn from the numbers that stand in the README.
"""

import re
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROW = re.compile(r"^  (?P<family>\w+) +\d+ +(?P<before>[\d.]+)(?: !| \?)?(?: \([^)]*\))? +(?P<after>[\d.]+)", re.M)


def ladder(readme):
    """(families, models, mean-square z (families, models)) of what the demo printed, on captures that nothing was fitted to."""
    block = re.search(r"What the demo printed.*?```\n(.*?)```", readme, re.S)[1]
    models = re.search(r"^  family +n +(\S+) +(\S+)$", block, re.M).groups()
    rows = [(m["family"], [float(m["before"]), float(m["after"])]) for m in ROW.finditer(block)]
    return [family for family, _ in rows], models, [values for _, values in rows]


def draw(readme, path):
    """A hollow mark before, a filled one after; each with its number."""
    import matplotlib
    from matplotlib.figure import Figure

    families, models, values = ladder(readme)
    figure = Figure(figsize=(8, 3), layout="constrained")
    axes = figure.subplots()
    axes.axvspan(0.5, 2.0, color="0.92")
    axes.axvline(1, color="0.5", ls=":", lw=1)
    for y, (before, after) in enumerate(values):
        axes.plot([before, after], [y, y], color="0.6", lw=2, zorder=1)
        axes.plot(before, y, "o", mfc="white", mec="tab:red", ms=8, label=f"before: {models[0]}" if y == 0 else None)
        axes.plot(after, y, "o", color="tab:green", ms=8, label=f"after: {models[-1]}" if y == 0 else None)
        if before > 3:  # elsewhere both lie at 1
            axes.text(1.3 * before, y, f"{before:.3f}", va="center", fontsize=9)
            axes.text(after / 1.3, y, f"{after:.3f}", va="center", ha="right", fontsize=9)
    axes.set(xscale="log", xlim=(0.12, 6e4), xlabel="mean-square z of captures that nothing was fitted to (1: agrees)")
    axes.set_yticks(range(len(families)), [family.replace("_", " ") for family in families])
    axes.invert_yaxis()
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="lower right", fontsize=9, frameon=False)
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "isetval"}):
        figure.savefig(path, metadata={"Date": None}, facecolor="white")


def with_numbers(readme, printed):
    """The README with the lines that a demo printed in the place of those that begin alike."""
    block = re.search(r"What the demo printed.*?```\n(.*?)```", readme, re.S)[1]
    lines = printed.splitlines()
    new = [next((p for p in lines if _begin(p) == _begin(line)), line) if line.strip() else line for line in block.splitlines()]
    return readme.replace(block, "\n".join(new) + "\n")


def _begin(line):
    """Indent and first word."""
    return re.match(r"\s*\S*", line)[0]


if __name__ == "__main__":
    file = HERE.parent / "README.md"
    text = file.read_text(encoding="utf-8")
    if len(sys.argv) > 1:
        text = with_numbers(text, Path(sys.argv[1]).read_text(encoding="utf-8"))
        file.write_text(text, encoding="utf-8")
    draw(text, HERE / "pictures" / "ladder.svg")
