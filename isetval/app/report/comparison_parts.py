"""What the page shows of a comparison: the ladder, where the model fails, plots, residuals, the table as CSV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from isetval.app.report import charts
from isetval.app.report.family_plots import family_plot
from isetval.app.words import relative_words, state_of

Row = Mapping[str, Any]
SYMBOL = {"agrees": "✓", "doubtful": "?", "fails": "✗", "unknown": "–"}
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


def held_rows(ladder: Sequence[Row]) -> list[Row]:
    """Rows of captures that nothing was fitted to, the hold-out where there is one; else all."""
    held = [row for row in ladder if row["role"] == "prediction"]
    return [row for row in held if row.get("captures") == held[-1].get("captures")] or list(ladder)


def ladder(rows: Sequence[Row]) -> tuple[list[str], list[dict[str, Row]], list[str]]:
    """Models, their rows by family, and the families."""
    models = list(dict.fromkeys(row["model"] for row in rows))
    columns = [{row["family"]: row for row in rows if row["model"] == m and row["mean_square_z"] is not None} for m in models]
    families = [f for f in dict.fromkeys(row["family"] for row in rows) if f != "all"]
    return models, columns, families


def by_model_of(comparison: Mapping[str, Any] | None) -> list[list[Row]]:
    """Rows of the table, one list a model."""
    if not comparison:
        return []
    return [[row for row in comparison["table"] if row["model"] == m] for m in comparison["models"]]


def match(models: Sequence[str], columns: Sequence[Mapping[str, Row]]) -> list[dict[str, Any]]:
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


def failing(
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


def _failing_rows(columns: Sequence[Mapping[str, Row]]) -> list[Row]:
    """Families in which the first model fails, worst first."""
    rows = [row for name, row in columns[0].items() if name != "all" and state_of(row["mean_square_z"], row["n"]) == "fails"]
    return sorted(rows, key=lambda row: -row["mean_square_z"])


def ladder_table(models: Sequence[str], columns: Sequence[Mapping[str, Row]], families: Sequence[str]) -> list[dict[str, Any]]:
    """Families against models as the page shows them."""
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


def failing_views(
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


def views(by_model: Sequence[Sequence[Row]]) -> list[dict[str, str]]:
    """Curves and scatter plots that people know."""
    wanted = (
        ("Photon transfer", "temporal variance over mean: slope is the conversion gain", charts.transfer_plot),
        ("Relative illumination", "field flats, each colour plane", charts.falloff_plot),
        ("Slanted edges", "SFR of every edge", charts.mtf_plot),
        ("Chart", "patch means", charts.patch_plot),
    )
    made = [{"name": name, "hint": hint, "svg": draw(by_model)} for name, hint, draw in wanted] if by_model else []
    return [view for view in made if view["svg"]]


def residuals(by_model: Sequence[Sequence[Row]], families: Sequence[str]) -> list[dict[str, str]]:
    """One plot of residuals a family."""
    out = []
    for family in families:
        parts = [[r for r in rows if r["family"] == family] for rows in by_model]
        if any(parts):
            out.append({"name": family.replace("_", " "), "hint": "", "svg": charts.residual_plot(family, parts)})
    return [plot for plot in out if plot["svg"]]


def csv_text(by_model: Sequence[Sequence[Row]]) -> str:
    """All rows of all models as CSV."""
    lines = [",".join(CSV_COLUMNS)]
    for rows in by_model:
        lines += [",".join(_cell(row.get(name)) for name in CSV_COLUMNS) for row in rows]
    return "\n".join(lines) if len(lines) > 1 else ""


def _cell(value: Any) -> str:
    if value is None:
        return ""
    words = (f"{value:.7g}" if isinstance(value, float) else str(value)).replace("<", "‹")
    return f'"{words}"' if "," in words or '"' in words else words
