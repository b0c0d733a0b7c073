"""An effect that may concern one patch of a chart: which of them it would be.

What it does to one patch is what it does to all of them, in the rows of that patch.  So each is weighed without being simulated,
and the best is a further form of the effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from isetval.loop.candidates import Candidate
from isetval.loop.evidence import Hypothesis, linear_model
from isetval.loop.problem import Problem
from isetval.loop.score_test import Frame, score
from isetval.loop.signatures import Signature
from isetval.loop.subset_sum import Term, best_with


def best_patch(
    problem: Problem, without: Hypothesis, frame: Frame, made: Sequence[Signature], klass: str, chance: float
) -> Candidate | None:
    """The form of an effect in the one patch where it explains most, alone or beside one other effect.

    Linear about a hypothesis ``without`` it, with the signatures ``made`` of all that is asked for.  None where no patch shows
    anything by a ``chance``, or all patches together explain as much.  Its prior is one of as many as there are patches.
    """
    whole = next(s for s in made if s.candidate.klass == klass and not getattr(s.candidate.effect, "patch", ""))
    metrics = problem.predictor.table.metrics
    of_patch = np.array([m.patch or "" for m in metrics])
    names = [name for name in dict.fromkeys(of_patch.tolist()) if name]
    columns = [np.where((of_patch == name)[:, None], whole.columns, 0.0) for name in names]
    white = problem.whitened_each(columns) if columns else []
    shown = [i for i, w in enumerate(white) if w.any()]
    side = whole.candidate.only_side
    if len(shown) < 2 or min(score(frame, white[i], side=side).p_value for i in shown) * len(shown) >= chance:
        return None
    tau, sides = whole.candidate.tau, whole.candidate.side
    own = [Term(klass, white[i], tau, sides) for i in shown]
    all_white = problem.whitened_each([s.columns for s in made])
    beside = [
        Term(s.candidate.name, w, s.candidate.tau, s.candidate.side)
        for s, w in zip(made, all_white, strict=True)
        if s.candidate.klass != klass
    ]
    every = Term(klass, all_white[list(made).index(whole)], tau, sides)
    logs = best_with(linear_model(problem, without.fitted, [*own, every, *beside]), len(own) + 1)
    best = int(np.argmax(logs[: len(own)]))
    if logs[best] - np.log(len(own)) <= logs[len(own)]:
        return None
    name = names[shown[best]]
    effect = whole.candidate.effect.changed(patch=name)
    return replace(whole.candidate, name=f"{klass} (patch {name})", effect=effect, prior_weight=1 / len(own))
