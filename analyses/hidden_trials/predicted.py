"""Confusions that ``identify`` predicts for a plan before anything is measured, held against those that happened."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

from hidden_trials.draw import NOMINAL

STORED = Path(__file__).resolve().parents[2] / "data" / "stored" / "predicted_confusions.json"


def predict(plan, *, path=STORED, say=print):
    """Store every pair of candidates whose signatures have a cosine above .7 in a plan, and what the plan cannot show."""
    import isetval
    from isetval.testing.foreign_camera.campaign import write_campaign

    with tempfile.TemporaryDirectory() as folder:
        write_campaign(folder, NOMINAL, seed=1, kind=plan, sessions=("A",), draw=False)
        model = isetval.load_model(Path(folder) / "camera.toml")
        found = isetval.identify(model, isetval.load_campaign(folder).as_plan(), say=say, with_next_captures=False)
    known = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    pairs = [[a, b, round(rho, 4)] for a, b, rho in found.pairs]
    known[plan] = {"pairs": pairs, "unobservable": list(found.unobservable)}
    path.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")


def held_against(rows, *, path=STORED):
    """Of wrong first names of effects and forms: how many are pairs that were predicted (plans without a prediction left out)."""
    known = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    out = []
    for row, j in rows:
        if row["kind"] not in ("single", "form") or row["plan"] not in known or not j.get("named") or j["first_right"]:
            continue
        rho = {frozenset(p[:2]): p[2] for p in known[row["plan"]]["pairs"]}
        pair = frozenset((row["truths"][0]["name"], j["named"][0]))
        out.append({"hidden": row["truths"][0]["name"], "said": j["named"][0], "rho": rho.get(pair), "id": row["id"]})
    return out
