"""What the page shows of the error budget, of captures beside simulations, and of one exposure along the light path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

PARTS = (
    ("sampling", "noise of the captures", "more frames"),
    ("specimen", "pattern of the specimen, shared by shots", "other places on the sensor"),
    ("simulation", "finite number of simulations", "more replicas or rays"),
    ("light", "light between frames", "a steadier lamp"),
)
LEAST_SHOWN = 5e-4  # relative change that is written; below it an effect does nothing here
UNEXPLAINED = 0.5  # of the variance: from here on the model is what is left to mend


def budget(comparison: Mapping[str, Any] | None) -> list[dict[str, Any]]:
    """Per family of the last model: shares of the variance in percent, what is beyond them, and what would help most."""
    rows = (comparison or {}).get("budget") or []
    last = rows[-1]["model"] if rows else ""
    out = []
    for row in rows:
        if row["model"] != last:
            continue
        best = max(PARTS, key=lambda part: row[part[0]])
        out.append(
            {
                "family": row["family"].replace("_", " "),
                "n": row["n"],
                "shares": [{"key": key, "words": words, "percent": round(100 * row[key], 1)} for key, words, _ in PARTS],
                "beyond": f"{row['unexplained']:.2f}",
                "helps": "the model" if row["unexplained"] > UNEXPLAINED else best[2],
            }
        )
    return out


def crops(pictures: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Captures beside simulations."""
    return list(pictures.get("crops", ()))


def light_paths(pictures: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The steps of one exposure under each model, with changes in words."""
    out = []
    for path in pictures.get("light_path", ()):
        steps = [
            {
                "effect": step["effect"].replace("_", " "),
                "stage": step["stage"],
                "mean": f"{step['mean']:.5g} {step['unit']}",
                "spread": f"{step['spread']:.3g}",
                "change": _percent(step["change"]),
                "wider": _percent(step["spread_change"]),
            }
            for step in path["steps"]
        ]
        stages = [{"unit": unit, "picture": url} for unit, url in path["pictures"].items()]
        out.append({"model": path["model"], "shot": path["shot"], "steps": steps, "pictures": stages})
    return out


def _percent(change: float | None) -> str:
    if change is None:
        return ""
    return f"{100 * change:+.1f} %" if abs(change) > LEAST_SHOWN else "-"


def pictures_of(results: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """The pictures that came with the results, those of the first that has any."""
    return next((r["pictures"] for r in results if r.get("pictures")), {})
