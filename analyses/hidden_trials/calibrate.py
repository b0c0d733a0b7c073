"""How many sigmas an effect of the foreign camera stands out by, in a plan, behind the laboratory's unknowns.

Three specimens are shot with the effect and without, and the unknowns are fitted to all of them: a focus error is a shift of
focus, not its slope.  The difference of whitened residuals and pulls is multiplied with that of another specimen: noise, which
is not the same in both, drops out.
"""

from __future__ import annotations

import json
import math
import tempfile
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

import isetval
from isetval.loop.derivatives import nuisance_parameters
from isetval.loop.fit import fit
from isetval.loop.nominal import nominal_of
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare
from isetval.loop.score_test import make_frame
from isetval.measure.campaign import measure_campaign
from isetval.testing.foreign_camera.camera_file import nominal_camera
from isetval.testing.foreign_camera.campaign import in_setting, write_campaign
from isetval.testing.foreign_camera.effects import STAGES
from isetval.testing.foreign_camera.strengths import ALL, STRENGTHS, WITHOUT_LAW, visible

SEEDS = (71, 72, 73)  # of specimens that no trial uses
WANTED = (10.0, 50.0)  # sigmas: above the noise of the products (about 4), below the bends of most metrics; under them: not seen
AIM = 20.0  # sigmas at which s is measured, where practice lies outside: near the trials' own strengths
AS_THE_POWER = 1.7  # ratio to the law within which twice the strength shows: metrics bend; one power more or less would be 2
TOO_STRONG = 20.0  # times the size in practice: beyond it the effect is another one than what practice meets
ROUNDS = 4


class Calibration:
    """A plan as the nominal camera shoots it, and what the nuisances can do in it."""

    def __init__(self, nominal_folder, plan, lens):
        self.nominal, self.plan, self.lens = Path(nominal_folder), plan, lens
        self.folder = tempfile.TemporaryDirectory()
        self.camera = in_setting(nominal_camera(self.nominal / "camera.toml"), lens)
        first = self._shot("null_0", None, SEEDS[0])
        model = isetval.load_model(Path(first.folder) / "camera.toml")
        self.prepared = prepare(model, first)
        self.choices = nominal_of(self.prepared.model, first)
        self.problem = self.prepared.problem
        self.null = [self._values(self._shot(f"null_{seed}", None, seed)) for seed in SEEDS]
        frames = [self._frame(values) for values in self.null]
        self.frame, self.null_left = frames[0], [frame.z for frame in frames]

    def _shot(self, name, hidden, seed):
        where = Path(self.folder.name) / name
        write_campaign(
            where, self.nominal, seed=seed, hidden=hidden, kind=self.plan, lens=self.lens, sessions=("A",), draw=False
        )  # fmt: skip
        return isetval.load_campaign(where)

    def _values(self, campaign):
        """Values in the order of the first campaign's metrics, measured as a diagnosis does; nan where one cannot be measured."""
        table = measure_campaign(campaign, choices=self.choices.that_hold, summaries=False)
        found = {m.key(): v for m, v in zip(table.metrics, table.values, strict=True)}
        return np.array([found.get(m.key(), np.nan) for m in self.prepared.table.metrics])

    def _frame(self, values):
        """Whitened residuals and pulls of the unknowns that fit these values best."""
        problem, model = replace(self.problem, measured=values), self.prepared.model
        return make_frame(fit(problem, Point(model), nuisance_parameters(problem.plan, model), stated=True))

    def differences(self, concealed, strength):
        """What the effect changes in three specimens that the unknowns cannot, whitened, and their pulls."""
        hidden = {concealed.key: concealed.parameters(strength, self.camera)}
        parts = []
        for seed, null, left in zip(SEEDS, self.null, self.null_left, strict=True):
            values = self._values(self._shot(f"{concealed.key}_{strength:.6g}_{seed}", hidden, seed))
            parts.append(self._frame(np.where(np.isfinite(values), values, null)).z - left)
        return parts

    def sigmas(self, concealed, strength):
        """s of the effect at a strength."""
        return math.sqrt(max(common_square(self.differences(concealed, strength)), 0.0))


def common_square(parts):
    """Squared length of what vectors (n,) have in common: the mean product of two of them, which noise of each drops out of."""
    return float(np.mean([float(a @ b) for a, b in combinations(parts, 2)]))


def s_at_one(calibration, concealed):
    """s at strength 1 by the power law, measured at a strength that stands out clearly; 0 where nothing follows the law."""
    strength = 1.0
    for _ in range(ROUNDS):
        s = calibration.sigmas(concealed, strength)
        if not concealed.scaled:
            return s
        if WANTED[0] <= s <= WANTED[1]:
            break
        step = AIM / max(s, AIM / 5)
        strength *= max(step, 0.1) ** (1 / concealed.power)
    if s < WANTED[0] or strength >= TOO_STRONG:
        return 0.0
    twice = calibration.sigmas(concealed, 2 * strength) / (s * 2**concealed.power)
    return s / strength**concealed.power if 1 / AS_THE_POWER < twice < AS_THE_POWER else 0.0


def follows_below(calibration, concealed, one):
    """Whether s follows the power law at half of the strength at which it is measured too; ``one`` is that at strength 1.

    Asked where whole codes are rounded anew, which may all stay what they are.
    """
    if concealed.key not in STAGES["file"] or not concealed.scaled:
        return True
    half = AIM / 2
    return (
        one > 0 and 1 / AS_THE_POWER < calibration.sigmas(concealed, (half / one) ** (1 / concealed.power)) / half < AS_THE_POWER
    )


def calibrate(nominal_folder, plan, lens, *, names=(), path=STRENGTHS, say=print):
    """Measure s at strength 1 of all that shows in a plan; writes after each, so that a killed run loses one."""
    if unknown := set(names) - {c.key for c in ALL.values() if visible(c, plan)}:
        raise SystemExit(f"--names: {unknown.pop()} is nothing that shows in the plan {plan}; see isetval/testing/foreign_camera")
    known = json.loads(Path(path).read_text(encoding="utf-8")) if Path(path).is_file() else {}
    own = known.setdefault(f"{plan}/{lens}", {})
    wanted = [c for c in ALL.values() if visible(c, plan) and (c.key in names or (not names and c.key not in own))]
    if not wanted:
        return
    calibration = Calibration(nominal_folder, plan, lens)
    for concealed in wanted:
        one = s_at_one(calibration, concealed)
        lawless = known.setdefault(WITHOUT_LAW, {}).setdefault(f"{plan}/{lens}", {})
        lawless.pop(concealed.key, None)
        if not follows_below(calibration, concealed, one):
            one, lawless[concealed.key] = calibration.sigmas(concealed, 1.0), "whole codes are rounded anew"
        own[concealed.key] = round(one, 3)
        say(f"{plan}/{lens} {concealed.key}: s {own[concealed.key]:.2f} at the strength of practice")
        Path(path).write_text(json.dumps(known, indent=1, sort_keys=True) + "\n", encoding="utf-8")
