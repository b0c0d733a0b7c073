"""The catalogue of effects as a page: docs/effects.md, from what the classes say of themselves.

python analyses/catalogue_page.py
"""

from __future__ import annotations

import inspect
import textwrap
from pathlib import Path

from isetval.core.effect import STAGES, Effect
from isetval.effects import catalogue

PAGE = Path(__file__).resolve().parents[1] / "docs" / "effects.md"
HEAD = """# The catalogue of effects

Made by `python analyses/catalogue_page.py` from the classes of `isetval/effects`; on the terminal: `isetval effects NAME`.

Every effect is one step on the way of the light: it acts on a signal and gives one. With every parameter at *no effect* it
changes nothing. *Plausible scale* is the width of its prior in a diagnosis. Parameters marked *shape* have no meaning where the
effect is absent; of those with a scale it is asked once the effect is named: they are fitted where the data ask for it, else what
the data leave open of them is in the error of its strength. Most effects have, beside their own form, *any smooth
one along* an axis: the effect times 1 + f, f a spline under a smoothness prior (`isetval/effects/free_form.py`). A diagnosis
says "form of" such an effect where its own form does not do, and draws the curve; in a model file the curve is `free_1`,
`free_2`, ...
"""


def section(cls: type[Effect]) -> str:
    """One effect."""
    text = inspect.cleandoc(cls.__doc__ or "").replace("``", "`")
    lines = [f"### `{cls.name}`", "", text, "", f"* equation: `{cls.equation}`", f"* source: {cls.reference}"]
    lines.append(f"* does not occur in: {cls.absent}")
    lines.append(f"* imitated by: {', '.join(f'`{name}`' for name in cls.imitated_by)}")
    if cls.must_not_change:
        lines.append(f"* leaves alone (tested): {', '.join(cls.must_not_change)}")
    if cls.forms:
        lines += [
            f"* `{field}`: {', '.join(f'{v:g}' if isinstance(v, float) else v for v in own)}" for field, own in cls.forms.items()
        ]
    if cls.free is not None:
        lines.append(f"* other forms: any smooth one along the {cls.free.axis}")
    if not cls.candidate:
        lines.append("* no candidate of a diagnosis")
    table = [
        f"| `{p.name}` | {p.unit} | {p.low:g} to {p.high:g} | {p.null:g} | "
        f"{'' if p.tau is None else f'{p.tau:g}'} | {p.doc}{' (shape)' if p.shape else ''} |"
        for p in cls.parameters()
    ]
    if table:
        lines += ["", "| parameter | unit | bounds | no effect | plausible scale | |", "|---|---|---|---|---|---|", *table]
    return "\n".join(lines)


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    known = catalogue().values()
    for stage in STAGES:
        names = [cls for cls in known if cls.stage == stage and cls.__module__.startswith("isetval.")]
        parts += [f"## {stage.capitalize()}\n", *(textwrap.dedent(section(cls)) + "\n" for cls in names)]
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page())
    print(f"{PAGE}: {len(catalogue())} effects")
