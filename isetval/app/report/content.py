"""From results to what the page shows: verdict, suspects, ladder, plots, nuisances, provenance."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from isetval.app.report import charts
from isetval.app.report.budget_parts import budget, crops, light_paths, pictures_of
from isetval.app.report.comparison_parts import (
    by_model_of,
    csv_text,
    failing,
    failing_views,
    held_rows,
    ladder,
    ladder_table,
    match,
    residuals,
    views,
)
from isetval.app.report.diagnosis_parts import candidates, in_sample, missing
from isetval.app.words import VERDICT_WORDS, shortfall_words, state_of, verdict_words, with_sigma

Row = Mapping[str, Any]
TONE = {
    "consistent": "good",
    "attributed": "good",
    "ambiguous": "open",
    "partial": "open",
    "unexplained": "bad",
    "gate_failed": "bad",
    "unfinished": "open",
}


def page_content(results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Everything the template needs, from results of measure, compare, diagnose or demo."""
    demo = next((r for r in results if r.get("kind") == "demo"), None)
    diagnosis = demo["diagnosis"] if demo else next((r for r in results if "verdict" in r and "effects" in r), None)
    comparison = demo["after"] if demo else next((r for r in results if "table" in r and "ladder" in r), None)
    measured = [r for r in results if r.get("kind") == "measure"]
    rows = held_rows((comparison or diagnosis or {}).get("ladder", []))
    models, columns, families = ladder(rows)
    by_model = by_model_of(comparison)
    pictures = pictures_of(results)
    return {
        "title": _title(demo, diagnosis, comparison, measured),
        "headline": _headline(diagnosis, models, columns),
        "match": match(models, columns),
        "failing": failing(comparison, models, columns),
        "missing": missing(diagnosis, demo),
        "bars": charts.ladder_bars(families, columns) if columns else "",
        "narrow_bars": charts.ladder_bars(families, columns, narrow=True) if columns else "",
        "models": models,
        "ladder": ladder_table(models, columns, families),
        "in_sample": in_sample(diagnosis),
        "held_out": all(row["role"] == "prediction" for row in rows),
        "failing_views": failing_views(by_model, columns),
        "planes": charts.planes_shown(by_model),
        "views": views(by_model),
        "residuals": residuals(by_model, families),
        "budget": budget(comparison),
        "crops": crops(pictures),
        "light_paths": light_paths(pictures),
        "candidates": candidates(diagnosis),
        "diagnosis": diagnosis,
        "nuisances": _nuisances(comparison),
        "gate": (comparison or diagnosis or {}).get("gate") or {},
        "metrics": [_metric_section(r) for r in measured],
        "between": _between(measured),
        "provenance": [_provenance(r) for r in results],
        "csv": csv_text(by_model),
        "json": json.dumps([_slim(r) for r in results], allow_nan=False).replace("<", "\\u003c"),
    }


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


def _slim(result: Mapping[str, Any]) -> dict[str, Any]:
    """A result without the long tables, which are in the CSV."""
    out = {k: v for k, v in result.items() if k not in ("table", "metrics", "files", "before", "after", "pictures")}
    for key in ("before", "after"):
        if key in result:
            out[key] = {k: v for k, v in result[key].items() if k != "table"}
    return out
