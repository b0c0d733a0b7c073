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
from isetval.testing.foreign_camera.strengths import ALL, LAW_FROM, STRENGTHS, WITHOUT_LAW, visible

SEEDS = (71, 72, 73)  # of specimens that no trial uses
WANTED = (10.0, 50.0)  # sigmas: above the noise of the products (about 4), below the bends of most metrics; under them: not seen
AIM = 20.0  # sigmas at which s is measured, where practice lies outside: near the trials' own strengths
AS_THE_POWER = 1.7  # ratio to the law within which twice the strength shows: metrics bend; one power more or less would be 2
TOO_STRONG = 20.0  # times the size in practice: beyond it the effect is another one than what practice meets
TRIED_AT = (5.0, 8.0, 10.0)  # sigmas at which a law is tried, which roundings may end: what trials hide, and the half of `AIM`
SURE = 3.0  # standard deviations beyond which a law is denied: of the 160 that are tried together 2 would deny several by chance
NO_LAW = "fewer codes change than it takes"
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


def error_of_common_square(parts):
    """Standard deviation of `common_square` by what specimens do not have in common: noise that a change of the light draws anew.

    Of a product of two vectors (n,) with a length s in common and a variance v beside it n v^2 + 2 s^2 v, of m products of few
    specimens the first part over m, the second over the specimens.
    """
    n, common = len(parts[0]), max(common_square(parts), 0.0)
    own = max(float(np.mean([part @ part for part in parts])) - common, 0.0) / n
    return math.sqrt(n * own**2 / math.comb(len(parts), 2) + 4 * common * own / len(parts))


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


def law_from(calibration, concealed, one):
    """The least of `TRIED_AT` sigmas at which s follows the power law, ``one`` being that at strength 1; inf where none does.

    Whole codes that are rounded anew may all stay what they are: a raw filter that is weak enough turns none.  0: it follows as
    far down as trials go.
    """
    if not concealed.scaled:
        return 0.0
    for wanted in TRIED_AT if one > 0 else ():
        parts = calibration.differences(concealed, (wanted / one) ** (1 / concealed.power))
        found, error = common_square(parts), SURE * error_of_common_square(parts)
        if found + error > (wanted / AS_THE_POWER) ** 2 and found - error < (wanted * AS_THE_POWER) ** 2:
            return 0.0 if wanted == min(TRIED_AT) else wanted
    return math.inf


def calibrate(nominal_folder, plan, lens, *, names=(), path=STRENGTHS, laws_alone=False, say=print):
    """Measure s at strength 1 of all that shows in a plan, and from where on its law holds; or the latter alone, of what has one.

    Writes after each, so that a killed run loses one.
    """
    if unknown := set(names) - {c.key for c in ALL.values() if visible(c, plan)}:
        raise SystemExit(f"--names: {unknown.pop()} is nothing that shows in the plan {plan}; see isetval/testing/foreign_camera")
    known = json.loads(Path(path).read_text(encoding="utf-8")) if Path(path).is_file() else {}
    own, lawless, least = (known.setdefault(k, {}) for k in (f"{plan}/{lens}", WITHOUT_LAW, LAW_FROM))
    lawless, least = (part.setdefault(f"{plan}/{lens}", {}) for part in (lawless, least))
    asked = [c for c in ALL.values() if visible(c, plan) and (c.key in names or not names)]
    if laws_alone:
        wanted = [c for c in asked if own.get(c.key) and c.scaled and c.key not in least and c.key not in lawless]
    else:
        wanted = [c for c in asked if names or c.key not in own]
    if not wanted:
        return
    calibration = Calibration(nominal_folder, plan, lens)
    for concealed in wanted:
        one = own[concealed.key] if laws_alone else s_at_one(calibration, concealed)
        lowest = law_from(calibration, concealed, one)
        lawless.pop(concealed.key, None)
        least.pop(concealed.key, None)
        if one > 0 and lowest > max(TRIED_AT):
            one, lawless[concealed.key] = calibration.sigmas(concealed, 1.0), NO_LAW
        elif one > 0:
            least[concealed.key] = lowest
        own[concealed.key] = round(one, 3)
        say(f"{plan}/{lens} {concealed.key}: s {own[concealed.key]:.2f} at the strength of practice, {_law(lowest)}")
        Path(path).write_text(json.dumps(known, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def _law(lowest):
    """From where on a law holds, in words."""
    return f"by its law from {lowest or min(TRIED_AT):g} on" if math.isfinite(lowest) else "by no law below"
