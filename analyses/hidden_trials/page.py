"""The page of a scoring run: table, power, reliability, pulls, confusions, every wrong answer."""

from __future__ import annotations

import io
import math
from html import escape

STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:70em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse;margin:1em 0}td,th{padding:.2em .7em;border-bottom:1px solid #ddd;text-align:left;"
    "vertical-align:top}td.n{text-align:right;font-variant-numeric:tabular-nums}.miss{color:#b00020}.fine{color:#126b2e}.open{color:#8a5a00}"
    "svg{max-width:100%;height:auto}h2{margin-top:2em}.small{font-size:13px;color:#555}"
)


def write_page(found, path):
    """Write one self-contained HTML file."""
    parts = [
        f"<h1>Hidden effects: {found['n']} trials</h1>",
        f"<p>{escape(', '.join(found['sets']))}; isetval {found['isetval']} at commit "
        f"{escape(', '.join(found['commits']))}, {found['date']}. Campaigns are shot by a "
        "camera that shares no code with isetval (<code>isetval.testing.foreign_camera</code>); no answer counts as wrong. "
        "Intervals are Wilson's 95 %; green: the share meets its target, amber: only its interval does, red: neither.</p>",
        _empty(found),
        _lawless(found),
        _targets(found),
        "<h2>Power</h2>", _svg(_power, found), "<h2>Is the stated posterior true?</h2>", _svg(_reliability, found),
        "<h2>Pulls of fitted parameters</h2>", _svg(_pulls, found),
        "<h2>Families on true models</h2>", _families(found),
        "<h2>What was said of what</h2>", _confusion(found), _predicted(found),
        "<h2>Every wrong answer</h2>", _wrong(found),
    ]  # fmt: skip
    head = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Hidden effects</title><style>{STYLE}</style>'
    path.write_text(head + "\n".join(parts) + "</html>\n", encoding="utf-8")


def _empty(found):
    if not found.get("empty"):
        return ""
    return (
        "<p>Left out, since of an effect that is hidden no frame has a bit (less than half a code in effects that act on whole "
        f"codes): {escape(', '.join(found['empty']))}.</p>"
    )


def _lawless(found):
    if not found.get("lawless"):
        return ""
    return (
        "<p>Left out, since how far what is hidden stands out by is not known (fewer codes change than the law of its "
        f"strength says): {escape(', '.join(found['lawless']))}.</p>"
    )


def _table(head, rows):
    top = "".join(f"<th>{escape(h)}</th>" for h in head)
    body = "".join("<tr>" + "".join(cells) + "</tr>" for cells in rows)
    return f"<table><tr>{top}</tr>{body}</table>"


def _cell(text, kind=""):
    return f'<td class="{kind}">{escape(str(text))}</td>'


def _percent(value):
    return "-" if value is None else f"{100 * value:.1f} %"


def _targets(found):
    rows = []
    for t in found["targets"]:
        span = "" if t["share"] is None else f"{_percent(t['low'])} to {_percent(t['high'])}"
        kind = "" if t["share"] is None else _met(t)
        cells = [
            _cell(t["what"]),
            _cell(t["target"]),
            _cell(_percent(t["share"]), f"n {kind}"),
            _cell(span, "n"),
            _cell(t["n"], "n"),
        ]
        rows.append(cells)
    gap = found["against_oracle"]
    if gap["n"]:
        words = f"{gap['median_gap']:+.3f}, {gap['largest_gap']:+.3f} at most"
        cells = ["held-out mean-square z above the true model's, median", "within .02", words, "", gap["n"]]
        rows.append([_cell(c) for c in cells])
    outcomes = "; ".join(
        f"{kind}: " + ", ".join(f"{n} {o}" for o, n in own.items()) for kind, own in found["by_kind"].items() if own
    )
    cpu = found["cpu_s"]
    return (
        _table(("quantity", "target", "measured", "95 % interval", "n"), rows)
        + f'<p class="small">{escape(outcomes)}. CPU {cpu["median"]:.0f} s a trial, {cpu["total"] / 3600:.2f} h in all.</p>'
    )


def _met(target):
    """``fine`` where the measured share meets its target, ``open`` where only its interval does, else ``miss``."""
    words = target["target"].replace("%", "").split()
    numbers = [float(w) / 100 for w in words if w.replace(".", "").isdigit()]
    if not numbers:
        return ""
    low, high = (0.0, numbers[0]) if words[0] == "<=" else (numbers[0], 1.0 if len(numbers) == 1 else numbers[1])
    if low <= target["share"] <= high:
        return "fine"
    return "open" if target["low"] <= high and target["high"] >= low else "miss"


def _svg(draw, found):
    import matplotlib

    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
    told = draw(axes, found)
    out = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "isetval"}):  # text as text: no glyphs drawn three times
        figure.savefig(out, format="svg", metadata={"Date": None})
    plt.close(figure)
    text = out.getvalue()
    return text[text.index("<svg") :] if told else "<p>No trial tells.</p>"


def _power(axes, found):
    rows = found["power"]
    for key, label, color in (("detected", "detected", "#1f5fa8"), ("right", "named rightly", "#126b2e")):
        s, p = [r["s"] for r in rows], [r[key]["share"] for r in rows]
        spread = [
            [x - r[key]["low"] for x, r in zip(p, rows, strict=True)],
            [r[key]["high"] - x for x, r in zip(p, rows, strict=True)],
        ]
        axes.errorbar(s, p, yerr=spread, fmt="o", label=label, color=color, capsize=3)
    grid = [0.5 + 0.1 * i for i in range(500)]
    axes.plot(
        grid,
        [0.5 * math.erfc(-(s - 3.67) / math.sqrt(2)) for s in grid],
        color="#999",
        lw=1,
        label="Φ(s - 3.67): 1 % false alarms",
    )
    axes.set(xscale="log", xlabel="expected significance s", ylabel="share", ylim=(-0.05, 1.05))
    axes.legend(loc="lower right", fontsize="small")
    return bool(rows)


def _reliability(axes, found):
    rows = found["reliability"]["bins"]
    stated, right = [b["stated"] for b in rows], [b["share"] for b in rows]
    spread = [[b["share"] - b["low"] for b in rows], [b["high"] - b["share"] for b in rows]]
    axes.plot([0, 1], [0, 1], color="#999", lw=1)
    axes.errorbar(stated, right, yerr=spread, fmt="o", capsize=3)
    words = "\n".join(f"{b['stated']:.2f} stated, {b['share']:.2f} right, n = {b['n']}" for b in rows)
    axes.text(1.03, 0.97, words, transform=axes.transAxes, va="top", fontsize=9)  # at the points they lie on one another
    axes.set(xlabel="stated posterior of the first name", ylabel="share right", xlim=(0, 1.03), ylim=(-0.05, 1.05))
    return bool(rows)


def _pulls(axes, found):
    values = [max(-8.0, min(8.0, p["pull"])) for p in found["pulls"]]
    axes.hist(values, bins=[-8 + 0.5 * i for i in range(33)], color="#1f5fa8")
    grid = [-4 + 0.1 * i for i in range(81)]
    axes.plot(grid, [len(values) * 0.5 * math.exp(-x * x / 2) / math.sqrt(2 * math.pi) for x in grid], color="#b00020")
    axes.set(xlabel="(found - true) / stated sigma, cut at 8", ylabel="parameters")
    return bool(values)


def _families(found):
    rows = []
    for f in found["families_on_nulls"]:
        value = f"{f['mean_square_z']:.3f} ± {f['error']:.3f}"
        away = max(0.9 - f["mean_square_z"], f["mean_square_z"] - 1.1)
        kind = "fine" if away <= 0 else "open" if away <= 2 * f["error"] else "miss"
        rows.append([_cell(f["family"]), _cell(value, f"n {kind}"), _cell(f["rows"], "n"), _cell(f["sessions"], "n")])
    return _table(("family", "mean-square z", "rows", "sessions"), rows)


def _confusion(found):
    return _table(
        ("hidden", "first name", "times"),
        [[_cell(c["hidden"]), _cell(c["said"]), _cell(c["n"], "n")] for c in found["confusion"]],
    )


def _predicted(found):
    rows = [
        [_cell(w["hidden"]), _cell(w["said"]), _cell("below .7" if w["rho"] is None else f"{w['rho']:.3f}", "n"), _cell(w["id"])]
        for w in found.get("confusions", [])
    ]
    words = "<p>Wrong first names, and the cosine of both signatures as <code>identify</code> predicts it for the plan:</p>"
    return words + _table(("hidden", "said", "rho", "trial"), rows) if rows else ""


def _wrong(found):
    rows = []
    for w in found["wrong"]:
        s = "/".join("?" if v is None else f"{v:.0f}" for v in w["expected_s"])
        rows.append([_cell(w["id"]), _cell(s, "n"), _cell(w["outcome"]), _cell(w["why"]), _cell(w["cause"])])
    return _table(("trial", "s", "outcome", "what was said", "cause"), rows)
