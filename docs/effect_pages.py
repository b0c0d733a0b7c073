"""A page for each effect of the catalogue, made from its class: text, equation, parameters, and its signature in the demo plan."""

from __future__ import annotations

import inspect
import re
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
SHOTS = ("A_dark0", "A_dark2", "A_flat1", "A_flat5", "A_field1", "A_field5", "A_edge_center_v_z0")
WIDTH = 78  # letters of a line of code beside the sidebar
LEAST = 1e-6  # relative change that is drawn: below it is rounding


def write_pages(app=None):
    """Write ``effects_by_name/NAME.md`` and the list of them; unchanged pages are left as they are."""
    from isetval.effects import catalogue

    folder = HERE / "effects_by_name"
    folder.mkdir(exist_ok=True)
    drawn = _signatures(folder)
    for name, cls in catalogue().items():
        _write(folder / f"{name}.md", _page(cls, name in drawn))
    _write(folder / "index.md", _index(catalogue()))


def _write(path, text):
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def _index(known):
    lines = ["# The effects, a page each", "", "Along the light path, as `isetval effects` lists them.", ""]
    for stage in dict.fromkeys(cls.stage for cls in known.values()):
        names = [name for name, cls in known.items() if cls.stage == stage]
        lines += [f"## {stage.capitalize()}", "", "```{toctree}", ":maxdepth: 1", "", *names, "```", ""]
    return "\n".join(lines)


def _page(cls, drawn):
    paragraphs = inspect.cleandoc(cls.__doc__ or "").split("\n\n")
    lines = [f"# {cls.name}", "", *(line for p in paragraphs for line in (_prose(p), ""))]
    facts = [
        ("stage", f"{cls.stage}, place {cls.order:g}"),
        ("acts on", f"{cls.acts_on or 'the scene'}, gives {cls.gives or 'the scene'}"),
    ]
    facts.append(("random", {"none": "no", "sensor": "fixed for a specimen", "frame": "new in every frame"}[cls.random]))
    facts.append(("leaves alone", ", ".join(cls.must_not_change) or "nothing is promised"))
    for key, words in (("absent", "does not occur"), ("absent_in", "does not occur"), ("imitated_by", "imitated by")):
        value = getattr(cls, key, None)
        if value:
            facts.append((words, value if isinstance(value, str) else ", ".join(map(str, value))))
    lines += ["| | |", "|---|---|", *(f"| {key} | {_cell(value)} |" for key, value in facts), ""]
    lines += ["## Equation", "", "```text", *textwrap.wrap(cls.equation, WIDTH), "```", "", f"Source: {cls.reference}", ""]
    if cls.parameters():
        lines += ["## Parameters", "", "| name | unit | range | no effect at | plausible scale | |", "|---|---|---|---|---|---|"]
        for p in cls.parameters():
            scale = "" if p.tau is None else f"{p.tau:g}"
            lines.append(f"| `{p.name}` | {_cell(p.unit)} | {p.low:g} to {p.high:g} | {p.null:g} | {scale} | {_cell(p.doc)} |")
        lines.append("")
    lines += ["In a model:", "", "```toml", "[[effect]]", f'name = "{cls.name}"']
    lines += [f"{p.name} = {p.null if p.tau is None else p.null + p.tau:g}" for p in cls.parameters() if not p.shape] + [
        "```",
        "",
    ]
    if drawn:
        lines += ["## Signature in the demo plan", "", f"![signature of {cls.name}]({cls.name}.svg)", ""]
        lines += [
            "Change of the noise-free mean, and of the spread of one frame in percent (bars: two standard errors), in seven shots, "
            "when the effect stands one plausible scale above the Pixel 4a.",
            "",
        ]
    else:
        lines += ["## Signature in the demo plan", "", _why_none(cls), ""]
    lines += ["## Checked by", "", *(f"- `{path}`" for path in _tests(cls.name)), ""]
    return "\n".join(lines)


def _why_none(cls):
    """Why an effect has no picture."""
    if cls.files():
        return "None here: what it does is in the file that it names."
    if not any(p.tau for p in cls.parameters()):
        return "None here: it has no strength that could be one step more; a model holds it or not."
    return "None here: the Pixel 4a's model has no lens file, whose chief rays it needs."


def _prose(paragraph):
    """A paragraph of a docstring as Markdown: its code stays code, its signs stay signs."""
    parts = re.split(r"``?([^`]+)``?", " ".join(paragraph.split()))
    return "".join(f"`{part}`" if i % 2 else re.sub(r"([\\*_{}\[\]<>#|$~^])", r"\\\1", part) for i, part in enumerate(parts))


def _cell(text):
    return str(text).replace("|", "\\|").replace("\n", " ")


def _tests(name):
    """Test files of the effects that speak of an effect: closed forms beside the battery."""
    root = HERE.parent
    files = sorted((root / "tests" / "effects").glob("test_*.py"))
    found = [path.relative_to(root).as_posix() for path in files if name in path.read_text(encoding="utf-8")]
    return found or ["tests/effects (the battery of every effect: isetval.testing.check_effect)"]


def _signatures(folder):
    """Draw what cannot be told in words; the names that have a picture."""
    import isetval
    from isetval.core.toml import data_folder
    from isetval.effects import catalogue

    model = isetval.load_model("isetval:pixel4a")
    plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml").only(SHOTS)
    plan = replace(plan, shots=tuple(replace(shot, frames=1) for shot in plan.shots))
    before = _levels(model, plan)
    drawn = set()
    for name, cls in catalogue().items():
        if cls.files() or not any(p.tau for p in cls.parameters()):
            continue
        try:
            start = model.effect(name) or cls()
            values = {p.name: min(start.values()[p.name] + p.tau, p.high) for p in cls.parameters() if p.tau and not p.shape}
            after = _levels(model.with_effect(start.changed(**values)), plan)
        except isetval.InputError:
            continue  # needs what the Pixel 4a's model lacks, such as a lens file
        _draw(folder / f"{name}.svg", before, after)
        drawn.add(name)
    return drawn


def _levels(model, plan):
    """Noise-free mean, standard deviation of a frame and its sampling error, DN above black in R, of every shot of a plan."""
    import isetval

    shot = isetval.simulate(model, plan, seed=1)
    rows = []
    for s in plan.shots:
        red = shot.captures.read(s.name)[0].mosaic[0::2, 0::2].astype(float)
        mean = model.expected(s, lights=plan.lights)[0::2, 0::2].mean() - 64
        rows.append([mean, red.std(), red.std() / np.sqrt(2 * (red.size - 1))])
    return np.array(rows)


def _draw(path, before, after):
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 2.6), layout="constrained")
    for axis, column, words in zip(
        figure.subplots(1, 2), (0, 1), ("mean above black, R (DN)", "standard deviation, R (%)"), strict=True
    ):
        change = after[:, column] - before[:, column]
        percent = 100 / before[:, 1]  # of flats a few DN, of an edge hundreds: side by side as shares
        change = change if column == 0 else change * percent
        error = None if column == 0 else 2 * np.hypot(before[:, 2], after[:, 2]) * percent  # noise of two frames, drawn anew
        axis.bar(range(len(SHOTS)), change, yerr=error, color=["tab:gray"] * 2 + ["tab:blue"] * 4 + ["tab:orange"], ecolor="0.4")
        axis.set_xticks(range(len(SHOTS)), [s[2:].replace("_center_v_z0", "") for s in SHOTS], rotation=40, fontsize=7)
        axis.axhline(0, color="0.4", lw=0.6)
        axis.set_ylabel(f"change of the\n{words}", fontsize=7)
        axis.tick_params(labelsize=7)
        if np.abs(change).max() < LEAST:
            axis.set_ylim(-1, 1)
    with rc_context({"svg.hashsalt": "isetval"}):
        figure.savefig(path, metadata={"Date": None})


def setup(app):
    """Make the pages before Sphinx reads the sources."""
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True}
