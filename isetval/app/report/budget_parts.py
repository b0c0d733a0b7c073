"""What the page shows of the error budget, of captures beside simulations, and of one exposure along the light path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from isetval.app.words import state_of

PARTS = (
    ("sampling", "noise of the captures", "more frames"),
    ("specimen", "pattern of the specimen, shared by shots", "other places on the sensor"),
    ("simulation", "finite number of simulations", "more replicas"),
    ("render", "finite number of rays", "more rays"),
    ("color", "colors that nobody knows", "the camera's curves and the chart's reflectances"),
    ("light", "light between frames", "a steadier lamp"),
)
LEAST_SHOWN = 5e-4  # relative change that is written; below it an effect does nothing here
REMEDIES = (("misfit", "the model"), ("repeat", "set-ups that repeat better"), ("region", "regions without border or dirt"))


def budget(comparison: Mapping[str, Any] | None) -> list[dict[str, Any]]:
    """Per family of the last model: shares of the variance in percent, what is beyond them, and what would help most."""
    rows = (comparison or {}).get("budget") or []
    last = rows[-1]["model"] if rows else ""
    return [
        {
            "family": row["family"].replace("_", " "),
            "n": row["n"],
            "shares": [
                {"key": key, "words": words, "percent": round(100 * row.get(key, 0.0), 1)}
                for key, words, _ in PARTS
                if key in row
            ],
            "repeat": _beyond(row.get("repeat")),
            "region": _beyond(row.get("region")),
            "misfit": _beyond(row.get("misfit", row["unexplained"])),
            "beyond": _stands_out(row, max(row.get(key) or 0.0 for key, _ in REMEDIES)),
            "helps": _helps(row),
        }
        for row in rows
        if row["model"] == last
    ]


def _helps(row: Mapping[str, Any]) -> str:
    """The largest of what is beyond the error bars; where all of it is small, the largest share of the variance."""
    remedy, left = max(((words, row.get(key) or 0.0) for key, words in REMEDIES), key=lambda pair: pair[1])
    return remedy if _stands_out(row, left) else max(PARTS, key=lambda part: row.get(part[0], 0.0))[2]


def _stands_out(row: Mapping[str, Any], excess: float) -> bool:
    """Whether a mean square beyond 1 is more than so many rows show by chance."""
    return state_of(1 + excess, row["n"]) != "agrees"


def _beyond(value: float | None) -> str:
    return "" if value is None else f"{max(value, 0.0):.2f}"


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
