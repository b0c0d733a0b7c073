"""What the page shows of a diagnosis: what is missing, the suspects, the table of candidates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from isetval.app.report.form_plot import form_plot
from isetval.app.words import chance_words, effect_words, probability_words, with_sigma


def missing(diagnosis: Mapping[str, Any] | None, demo: Mapping[str, Any] | None) -> dict[str, Any]:
    """Named effects, what is left over, suspects, and what was hidden."""
    if not diagnosis:
        return {}
    named = [
        {
            "words": effect_words(e, sign="±"),
            "posterior": probability_words(e["posterior"]),
            "equivalent": [n.replace("_", " ") for n in e["equivalent"]],
            "form": form_plot(e),
            "command": f"isetval add MODEL {e['name']} --from diagnosis.json -o MODEL2",
        }
        for e in diagnosis["effects"]
    ]
    return {
        "named": named,
        "leftover": diagnosis.get("leftover"),
        "suspects": _suspects(diagnosis),
        "hidden": _hidden(diagnosis, demo),
    }


def _hidden(diagnosis: Mapping[str, Any], demo: Mapping[str, Any] | None) -> dict[str, Any] | None:
    if not demo:
        return None
    hidden = demo["hidden"]
    words = ", ".join(
        f"{k} {p['value']:.4g} {p['unit'] if p['unit'] != '1' else ''}".strip() for k, p in hidden["parameters"].items()
    )
    found = any(hidden["name"] in (e["name"], *e["equivalent"]) for e in diagnosis["effects"])
    return {"words": f"{hidden['name'].replace('_', ' ')} ({words})", "found": found}


def _suspects(diagnosis: Mapping[str, Any], count: int = 6) -> list[dict[str, Any]]:
    """The candidates that explain most, each in its best form, as shares of the best."""
    ranked = sorted((c for c in diagnosis["candidates"] if c["observable"] and (c["dchi2"] or 0) > 0), key=lambda c: -c["dchi2"])
    if not ranked:
        return []
    best: dict[str, Mapping[str, Any]] = {}
    for candidate in ranked:
        best.setdefault(_class(candidate), candidate)
    seen = list(best.values())
    named = {e["name"] for e in diagnosis["effects"]}
    tied = {n for e in diagnosis["effects"] for n in e["equivalent"]}
    top = seen[0]["dchi2"]
    return [
        {
            "name": c["name"].replace("_", " "),
            "share": round(100 * c["dchi2"] / top, 1),
            "dchi2": f"{c['dchi2']:.0f}",
            "significant": c["p_corrected"] < 0.01,
            "mark": "named" if _class(c) in named else "tied" if _class(c) in tied else "",
        }
        for c in seen[:count]
    ]


def _class(candidate: Mapping[str, Any]) -> str:
    """The effect that a candidate is a form of: "amp_glow" of "amp_glow (x0 -0.8)"."""
    return str(candidate["name"]).split(" (")[0]


def candidates(diagnosis: Mapping[str, Any] | None) -> list[dict[str, str]]:
    """Every observable candidate, the least probable by chance first; then those that explain most."""
    if not diagnosis:
        return []
    out = []
    seen = [c for c in diagnosis["candidates"] if c["observable"]]
    for c in sorted(seen, key=lambda c: (c["p_corrected"], -(c["dchi2"] or 0)))[:20]:
        estimate = ", ".join(f"{k} {with_sigma(p['value'], p['sigma'], sign='±')}" for k, p in c["estimate"].items())
        posterior = "" if c["posterior"] is None else f"{c['posterior']:.3f}"
        out.append(
            {
                "name": c["name"],
                "estimate": estimate,
                "dchi2": f"{c['dchi2']:.1f}",
                "p": chance_words(c["p_corrected"]),
                "posterior": posterior,
            }
        )
    return out


def in_sample(diagnosis: Mapping[str, Any] | None) -> list[str]:
    """Mean-square z of the captures that were fitted to, for comparison."""
    rows = [
        r
        for r in (diagnosis or {}).get("ladder", ())
        if r["role"] == "calibration" and r["family"] == "all" and r["mean_square_z"] is not None
    ]
    return [f"{row['mean_square_z']:.3f} {'after' if i else 'before'}" for i, row in enumerate(rows)]
