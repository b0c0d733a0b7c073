"""How many sigmas of a hidden effect lie along the signature that the detective has of it, in a plan.

A signature taken at another size than what is hidden, or of another kind, sees less than there is: such an effect is missed at
any strength at which it should be found.  Measured as `nearest` does, for the effects that the catalogue holds.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

from hidden_trials.calibrate import Calibration, common_square
from hidden_trials.nearest import bases_of
from isetval.testing.foreign_camera.concealed_effects import EFFECTS
from isetval.testing.foreign_camera.strengths import strength_for, visible

STORED = Path(__file__).resolve().parents[2] / "data" / "stored" / "own_signatures.json"
AIM = 8.0  # sigmas: the weakest at which 99 of 100 are to be found


def measure(nominal_folder, plan, lens, *, names=(), path=STORED, say=print):
    """Store, for every effect (or the named ones), its sigmas in all, along its own signature and along the nearest other.

    Writes after each, so that a killed run loses one.
    """
    wanted = [c for c in EFFECTS if visible(c, plan) and (not names or c.key in names)]
    if unknown := set(names) - {c.key for c in wanted}:
        raise SystemExit(
            f"--names: {unknown.pop()} is no effect that shows in the plan {plan}; see isetval/testing/foreign_camera"
        )
    calibration = Calibration(nominal_folder, plan, lens)
    bases = bases_of(calibration)
    known = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    own = known.setdefault(f"{plan}/{lens}", {})
    for concealed in wanted:
        strength = strength_for(concealed, AIM, plan, lens)
        if strength is None:
            say(f"{plan}/{lens} {concealed.key}: has no strength of {AIM:.0f} sigmas")
            continue
        own[concealed.key] = found = along_signatures(calibration.differences(concealed, strength), bases, concealed)
        say(f"{plan}/{lens} {concealed.key}: {found['own']} of {found['s']} sigmas, {found['nearest']} {found['nearest_s']}")
        path.write_text(json.dumps(known, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def along_signatures(parts, bases, concealed):
    """Sigmas that several specimens' differences have in common: in all, along the effect's own directions, along the nearest.

    ``own`` is the best of the forms of its name and of those that mean the same (`Concealed.also`).
    """
    along = {name: math.sqrt(max(common_square([basis.T @ part for part in parts]), 0.0)) for name, basis in bases.items()}
    right = {concealed.name, *concealed.also}
    mine = {name: s for name, s in along.items() if name.split(" (")[0] in right}
    others = {name: s for name, s in along.items() if name not in mine}
    nearest = max(others, key=others.get)
    return {
        "s": round(math.sqrt(max(common_square(parts), 0.0)), 1),
        "own": round(max(mine.values(), default=0.0), 1),
        "nearest": nearest,
        "nearest_s": round(others[nearest], 1),
    }
