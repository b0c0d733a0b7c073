"""From results to what the page shows: verdict, suspects, ladder, plots, nuisances, provenance."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from isetval.app.report import charts
from isetval.app.report.family_plots import family_plot
from isetval.app.report.form_plot import form_plot
from isetval.app.words import (
    VERDICT_WORDS,
    effect_words,
    probability_words,
    relative_words,
    shortfall_words,
    state_of,
    verdict_words,
    with_sigma,
)

Row = Mapping[str, Any]
SYMBOL = {"agrees": "✓", "doubtful": "?", "fails": "✗", "unknown": "–"}
TONE = {
    "consistent": "good",
    "attributed": "good",
    "ambiguous": "open",
    "partial": "open",
    "unexplained": "bad",
    "gate_failed": "bad",
}
CSV_COLUMNS = (
    "model",
    "family",
    "name",
    "channel",
    "shot",
    "region",
    "patch",
    "frequency_cy_px",
    "unit",
    "measured",
    "simulated",
    "sigma",
    "z",
)


def page_content(results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Everything the template needs, from results of measure, compare, diagnose or demo."""
    demo = next((r for r in results if r.get("kind") == "demo"), None)
    diagnosis = demo["diagnosis"] if demo else next((r for r in results if "verdict" in r and "effects" in r), None)
    comparison = demo["after"] if demo else next((r for r in results if "table" in r and "ladder" in r), None)
    measured = [r for r in results if r.get("kind") == "measure"]
    ladder = _held_rows((comparison or diagnosis or {}).get("ladder", []))
    models, columns, families = _ladder(ladder)
    by_model = _by_model(comparison)
    return {
        "title": _title(demo, diagnosis, comparison, measured),
        "headline": _headline(diagnosis, models, columns),
        "match": _match(models, columns),
        "failing": _failing(comparison, models, columns),
        "missing": _missing(diagnosis, demo),
        "bars": charts.ladder_bars(families, columns) if columns else "",
        "models": models,
        "ladder": _ladder_table(models, columns, families),
        "in_sample": _in_sample(diagnosis),
        "failing_views": _failing_views(by_model, columns),
        "views": _views(by_model),
        "residuals": _residuals(by_model, families),
        "candidates": _candidates(diagnosis),
        "diagnosis": diagnosis,
        "nuisances": _nuisances(comparison),
        "gate": (comparison or diagnosis or {}).get("gate") or {},
        "metrics": [_metric_section(r) for r in measured],
        "between": _between(measured),
        "provenance": [_provenance(r) for r in results],
        "csv": _csv(by_model),
        "json": json.dumps([_slim(r) for r in results], allow_nan=False).replace("<", "\\u003c"),
    }


def _held_rows(ladder: Sequence[Row]) -> list[Row]:
    """Rows of captures that nothing was fitted to, the hold-out where there is one; else all."""
    held = [row for row in ladder if row["role"] == "prediction"]
    return [row for row in held if row.get("captures") == held[-1].get("captures")] or list(ladder)


def _ladder(rows: Sequence[Row]) -> tuple[list[str], list[dict[str, Row]], list[str]]:
    models = list(dict.fromkeys(row["model"] for row in rows))
    columns = [{row["family"]: row for row in rows if row["model"] == m and row["mean_square_z"] is not None} for m in models]
    families = [f for f in dict.fromkeys(row["family"] for row in rows) if f != "all"]
    return models, columns, families


def _by_model(comparison: Mapping[str, Any] | None) -> list[list[Row]]:
    if not comparison:
        return []
    return [[row for row in comparison["table"] if row["model"] == m] for m in comparison["models"]]


def _title(*parts: Any) -> str:
    demo, diagnosis, comparison, measured = parts
    if demo:
        return f"isetval demo, seed {demo['seed']}"
    for part in (diagnosis, comparison):
        if part and part.get("campaign"):
            return f"{part.get('model') or ' and '.join(part.get('models', []))} against {part['campaign']}"
    return "isetval measurement" if measured else "isetval report"


def _headline(diagnosis: Mapping[str, Any] | None, models: Sequence[str], columns: Sequence[Mapping[str, Row]]) -> dict[str, str]:
    if diagnosis:
        said = " and ".join(shortfall_words(e) for e in diagnosis["effects"])
        begin = {"ambiguous": "The model probably", "partial": "Part of the answer: the model"}
        verdict = diagnosis["verdict"]
        text = (
            f"{begin.get(verdict, 'The model')} {said}."
            if said
            else f"{VERDICT_WORDS[verdict][:1].upper()}{VERDICT_WORDS[verdict][1:]}."
        )
        return {"text": text, "tone": TONE[verdict], "more": f"Verdict {verdict}: {verdict_words(diagnosis)}."}
    if columns and "all" in columns[-1]:
        row = columns[-1]["all"]
        state = state_of(row["mean_square_z"], row["n"])
        words = {"agrees": "agrees with", "doubtful": "nearly agrees with", "fails": "disagrees with"}[state]
        tone = {"agrees": "good", "doubtful": "open", "fails": "bad"}[state]
        return {
            "text": f"{models[-1]} {words} the captures.",
            "tone": tone,
            "more": "Nothing was diagnosed yet: isetval diagnose.",
        }
    return {"text": "Measured.", "tone": "open", "more": "No model was compared yet: isetval compare."}


def _match(models: Sequence[str], columns: Sequence[Mapping[str, Row]]) -> list[dict[str, Any]]:
    """Per model: overall mean-square z, and how many families agree."""
    out = []
    for model, column in zip(models, columns, strict=True):
        if "all" not in column:
            continue
        states = [state_of(row["mean_square_z"], row["n"]) for name, row in column.items() if name != "all"]
        whole = column["all"]
        out.append(
            {
                "model": model,
                "value": f"{whole['mean_square_z']:.2f}",
                "state": state_of(whole["mean_square_z"], whole["n"]),
                "n": whole["n"],
                "agree": sum(s != "fails" for s in states),
                "families": len(states),
            }
        )
    return out


def _failing(
    comparison: Mapping[str, Any] | None, models: Sequence[str], columns: Sequence[Mapping[str, Row]]
) -> list[dict[str, str]]:
    """The families in which the first model fails, worst first, with their worst place."""
    if not columns:
        return []
    return [
        {
            "family": row["family"].replace("_", " "),
            "z2": f"{row['mean_square_z']:.1f}",
            "error": relative_words(row),
            "worst": _worst(comparison, models[0], row["family"]),
        }
        for row in _failing_rows(columns)[:5]
    ]


def _worst(comparison: Mapping[str, Any] | None, model: str, family: str) -> str:
    rows = [
        r for r in (comparison or {}).get("table", ()) if r["model"] == model and r["family"] == family and r["z"] is not None
    ]
    if not rows:
        return ""
    row = max(rows, key=lambda r: abs(r["z"]))
    where = " ".join(str(row[k]) for k in ("shot", "channel", "region", "patch") if row.get(k))
    away = 100 * (row["simulated"] / row["measured"] - 1) if row["measured"] else 0.0
    tail = f", simulated {away:+.1f} %" if 0.05 < abs(away) < 100 else ""
    return f"{where}: z {row['z']:+.1f}{tail}"


def _missing(diagnosis: Mapping[str, Any] | None, demo: Mapping[str, Any] | None) -> dict[str, Any]:
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
    """The candidates that explain most, as shares of the best."""
    seen = [c for c in diagnosis["candidates"] if c["observable"] and (c["dchi2"] or 0) > 0]
    seen.sort(key=lambda c: -c["dchi2"])
    if not seen:
        return []
    named = {e["name"] for e in diagnosis["effects"]}
    tied = {n for e in diagnosis["effects"] for n in e["equivalent"]}
    top = seen[0]["dchi2"]
    return [
        {
            "name": c["name"].replace("_", " "),
            "share": round(100 * c["dchi2"] / top, 1),
            "dchi2": f"{c['dchi2']:.0f}",
            "significant": c["p_corrected"] < 0.01,
            "mark": "named" if c["name"] in named else "tied" if c["name"] in tied else "",
        }
        for c in seen[:count]
    ]


def _ladder_table(models: Sequence[str], columns: Sequence[Mapping[str, Row]], families: Sequence[str]) -> list[dict[str, Any]]:
    out = []
    for family in [*(["all"] if columns and "all" in columns[0] else []), *families]:
        cells = []
        for column in columns:
            row = column.get(family)
            state = state_of(row["mean_square_z"], row["n"]) if row else "unknown"
            value = f"{row['mean_square_z']:.2f}" if row else ""
            cells.append({"state": state, "symbol": SYMBOL[state], "value": value, "error": relative_words(row) if row else ""})
        n = next((c[family]["n"] for c in columns if family in c), 0)
        out.append({"family": family.replace("_", " "), "n": n, "cells": cells})
    return out


def _in_sample(diagnosis: Mapping[str, Any] | None) -> list[str]:
    rows = [
        r
        for r in (diagnosis or {}).get("ladder", ())
        if r["role"] == "calibration" and r["family"] == "all" and r["mean_square_z"] is not None
    ]
    return [f"{row['mean_square_z']:.3f} {'after' if i else 'before'}" for i, row in enumerate(rows)]


def _failing_views(
    by_model: Sequence[Sequence[Row]], columns: Sequence[Mapping[str, Row]], count: int = 4
) -> list[dict[str, str]]:
    """Measured and simulated of the families in which the first model fails, the worst first."""
    if not by_model or not columns:
        return []
    made = [(row, family_plot(row["family"], by_model)) for row in _failing_rows(columns)[:count]]
    return [
        {
            "name": row["family"].replace("_", " "),
            "hint": f"z² {row['mean_square_z']:.1f}; {plot.hint}".rstrip("; "),
            "svg": plot.svg,
        }
        for row, plot in made
        if plot.svg
    ]


def _failing_rows(columns: Sequence[Mapping[str, Row]]) -> list[Row]:
    """Families in which the first model fails, worst first."""
    rows = [row for name, row in columns[0].items() if name != "all" and state_of(row["mean_square_z"], row["n"]) == "fails"]
    return sorted(rows, key=lambda row: -row["mean_square_z"])


def _views(by_model: Sequence[Sequence[Row]]) -> list[dict[str, str]]:
    """Curves and scatter plots that people know."""
    wanted = (
        ("Photon transfer", "temporal variance over mean: slope is the conversion gain", charts.transfer_plot),
        ("Relative illumination", "field flats, each colour plane", charts.falloff_plot),
        ("Slanted edges", "SFR of every edge", charts.mtf_plot),
        ("Chart", "patch means", charts.patch_plot),
    )
    made = [{"name": name, "hint": hint, "svg": draw(by_model)} for name, hint, draw in wanted] if by_model else []
    return [view for view in made if view["svg"]]


def _residuals(by_model: Sequence[Sequence[Row]], families: Sequence[str]) -> list[dict[str, str]]:
    out = []
    for family in families:
        parts = [[r for r in rows if r["family"] == family] for rows in by_model]
        if any(parts):
            out.append({"name": family.replace("_", " "), "hint": "", "svg": charts.residual_plot(family, parts)})
    return [plot for plot in out if plot["svg"]]


def _candidates(diagnosis: Mapping[str, Any] | None) -> list[dict[str, str]]:
    if not diagnosis:
        return []
    out = []
    for c in sorted((c for c in diagnosis["candidates"] if c["observable"]), key=lambda c: c["p_corrected"])[:20]:
        estimate = ", ".join(f"{k} {with_sigma(p['value'], p['sigma'], sign='±')}" for k, p in c["estimate"].items())
        posterior = "" if c["posterior"] is None else f"{c['posterior']:.3f}"
        out.append(
            {
                "name": c["name"],
                "estimate": estimate,
                "dchi2": f"{c['dchi2']:.1f}",
                "p": f"{c['p_corrected']:.2g}",
                "posterior": posterior,
            }
        )
    return out


def _nuisances(comparison: Mapping[str, Any] | None) -> dict[str, Any]:
    if not comparison or not comparison.get("nuisances"):
        return {}
    models = [m for m in comparison["models"] if m in comparison["nuisances"]]
    labels = list(dict.fromkeys(label for m in models for label in comparison["nuisances"][m]))
    rows = []
    for label in labels:
        cells = [comparison["nuisances"][m].get(label) for m in models]
        rows.append({"label": label, "cells": ["" if c is None else with_sigma(c[0], c[1], sign="±") for c in cells]})
    return {"models": models, "rows": rows}


def _metric_section(result: Mapping[str, Any]) -> dict[str, Any]:
    rows = [
        {
            "name": m["name"],
            "where": " ".join(str(m[k]) for k in ("shot", "channel", "region", "patch") if m.get(k)),
            "value": with_sigma(m["value"], m["sigma"], m["unit"], sign="±"),
            "reason": m.get("reason", ""),
        }
        for m in result["metrics"][:400]
    ]
    skipped = result.get("skipped", ())
    return {
        "title": result.get("campaign") or "files",
        "rows": rows,
        "n": len(result["metrics"]),
        "skipped": skipped,
        "notes": result.get("notes", ()),
    }


def _between(measured: Sequence[Mapping[str, Any]]) -> list[dict[str, str]]:
    """Two measurements of the same things, row by row, largest difference first."""
    if len(measured) < 2:
        return []
    keys: tuple[str, ...] = ("name", "channel", "shot", "region", "patch", "frequency_cy_px", "file")
    first, second = ({tuple(m.get(k) for k in keys): m for m in r["metrics"]} for r in measured[:2])
    if not first.keys() & second.keys():
        keys = keys[:-1]
        first, second = ({tuple(m.get(k) for k in keys): m for m in r["metrics"]} for r in measured[:2])
    out = []
    for key in first.keys() & second.keys():
        a, b = first[key], second[key]
        sigma = ((a["sigma"] or 0) ** 2 + (b["sigma"] or 0) ** 2) ** 0.5
        if a["value"] is not None and b["value"] is not None and sigma > 0:
            out.append(((b["value"] - a["value"]) / sigma, a, b))
    out.sort(key=lambda entry: -abs(entry[0]))
    return [
        {
            "name": " ".join(str(a[k]) for k in keys if a.get(k)),
            "a": with_sigma(a["value"], a["sigma"], a["unit"], sign="±"),
            "b": with_sigma(b["value"], b["sigma"], b["unit"], sign="±"),
            "z": f"{z:+.1f}",
        }
        for z, a, b in out[:60]
    ]


def _provenance(result: Mapping[str, Any]) -> dict[str, Any]:
    made = result.get("provenance", {})
    inputs = made.get("inputs", {})
    return {
        "kind": result.get("kind", ""),
        "command": " ".join(made.get("command", []))
        or (f"isetval demo --seed {result['seed']}" if result.get("kind") == "demo" else ""),
        "versions": made.get("versions", {}),
        "inputs": [(path, entry["sha256"][:16]) for path, entry in list(inputs.items())[:40]],
        "more": max(0, len(inputs) - 40),
        "settings": json.dumps((result.get("after") or result).get("settings", {}))[:600],
    }


def _csv(by_model: Sequence[Sequence[Row]]) -> str:
    lines = [",".join(CSV_COLUMNS)]
    for rows in by_model:
        lines += [",".join(_cell(row.get(name)) for name in CSV_COLUMNS) for row in rows]
    return "\n".join(lines) if len(lines) > 1 else ""


def _cell(value: Any) -> str:
    if value is None:
        return ""
    words = (f"{value:.7g}" if isinstance(value, float) else str(value)).replace("<", "‹")
    return f'"{words}"' if "," in words or '"' in words else words


def _slim(result: Mapping[str, Any]) -> dict[str, Any]:
    """A result without the long tables, which are in the CSV."""
    out = {k: v for k, v in result.items() if k not in ("table", "metrics", "files", "before", "after")}
    for key in ("before", "after"):
        if key in result:
            out[key] = {k: v for k, v in result[key].items() if k != "table"}
    return out
