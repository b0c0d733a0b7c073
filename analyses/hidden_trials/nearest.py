"""How much of a stranger no single effect of the catalogue explains, in a plan.

What an effect does too is named as that effect, whoever looks at the numbers: only the part that no effect explains can be
flagged.  It is measured as `calibrate` measures s: what three specimens have in common, here beside the signature of each effect.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

from hidden_trials.calibrate import AIM, Calibration, common_square
from isetval.loop.candidates import candidates_for, gaps_of, lights_of, places_of
from isetval.loop.gaussian import orthonormal_basis
from isetval.loop.prediction import Point
from isetval.loop.signatures import signatures
from isetval.testing.foreign_camera.concealed_strangers import OUTSIDERS
from isetval.testing.foreign_camera.strengths import strength_for, visible

STORED = Path(__file__).resolve().parents[2] / "data" / "stored" / "outsiders_nearest.json"
TOLD = 5.0  # sigmas beside the nearest effect from which a flag is asked for: those at which an effect is to be seen in 9 of 10


def measure(nominal_folder, plan, lens, *, path=STORED, say=print):
    """Store, for every outsider that a plan shows, the effect that explains most of it and the share of s that this leaves.

    Writes after each, so that a killed run loses one.
    """
    calibration = Calibration(nominal_folder, plan, lens)
    bases = bases_of(calibration)
    known = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    own = known.setdefault(f"{plan}/{lens}", {})
    for concealed in (c for c in OUTSIDERS if visible(c, plan)):
        strength = strength_for(concealed, AIM, plan, lens) or 1.0
        parts = calibration.differences(concealed, strength)
        whole = common_square(parts)
        if whole <= 0:
            say(f"{plan}/{lens} {concealed.key}: does not show")
            continue
        explained = {name: common_square([basis.T @ part for part in parts]) for name, basis in bases.items()}
        name = max(explained, key=explained.get)
        left = math.sqrt(max(1 - explained[name] / whole, 0.0))
        own[concealed.key] = {"nearest": name, "left": round(left, 3), "s": round(math.sqrt(whole), 1)}
        say(f"{plan}/{lens} {concealed.key}: {name} leaves {left:.2f} of its length")
        path.write_text(json.dumps(known, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def bases_of(calibration):
    """Orthonormal directions of every candidate behind the nuisances, by name."""
    problem, frame = calibration.problem, calibration.frame
    model = calibration.prepared.model
    wanted = candidates_for(model, lights_of(problem.plan), gaps_of(problem.plan), places_of(problem.plan))
    made = signatures(problem, Point(model), wanted, project=frame.basis[: frame.rows])
    profiled = [(s.candidate.name, frame.profiled(problem.whitened(s.columns))) for s in made]
    return {name: orthonormal_basis(columns) for name, columns in profiled if columns.any()}


def tells_apart(row, *, path=STORED):
    """Whether an outsider's trial leaves `TOLD` sigmas beside the nearest effect; None where that was not measured."""
    known = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    found = known.get(f"{row.get('plan')}/{row['lens']}", {}).get(next(iter(row["hidden"])))
    return None if found is None else found["left"] * max(s or 0.0 for s in row["expected_s"]) >= TOLD
