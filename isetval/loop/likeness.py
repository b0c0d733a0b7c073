"""What else a named effect may be taken for, and how sure it is: it, or what the data do not tell from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.loop.candidates import Candidate
from isetval.loop.evidence import CLOSE_LOG_ODDS
from isetval.loop.investigation import ODDS, Investigation
from isetval.loop.posterior import Posterior
from isetval.loop.score_test import cosine
from isetval.loop.unknown_members import with_unknown

Float = NDArray[np.float64]
SAME_RHO = 0.95  # profiled cosine above which ten sigmas of one leave three of the other: not to be told apart
LIKELY = 0.5  # what one of several names must be: it claims to be a part of the story while that is likelier than not


@dataclass(frozen=True)
class Likeness:
    """What else could be meant by a named effect: ``rivals`` explain the data about as well, ``alike`` any data.

    Rivals do so alone or several together, each of them needed: beside one that does alone another may be there or not.  What
    explains them far better, and no turn was left to name it, is no rival: the data tell it from what is named.
    """

    rivals: tuple[str, ...]
    alike: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """All of them, each once."""
        return tuple(dict.fromkeys([*self.rivals, *self.alike]))


def likenesses(case: Investigation) -> dict[str, Likeness]:
    """Of every named effect: what may stand in its place in the sum, and what shows alike whatever is measured."""
    frame, white, logs = case.nominal_frame, nominal_signatures(case), case.table.logs
    stands, out = case.standing.names, {}
    others = [c.name for c in case.candidates if c.name not in (*stands, *case.unobservable)]
    klass = {c.name: c.klass for c in case.candidates}
    best = logs.get(stands, case.score(case.standing))
    close = sorted((names for names, log in logs.items() if abs(log - best) < CLOSE_LOG_ODDS), key=lambda names: -logs[names])
    for name in (m.name for m in case.standing.effects):
        rest = stands - {name}
        other = [o for o in others if klass[o] != klass[name]]
        instead = [names for names in close if rest < names and name not in names]
        needed = [names for names in instead if not any(fewer < names for fewer in instead)]
        near = [o for names in needed for o in sorted(names - rest) if o in other]
        alike = dict.fromkeys(klass[o] for o in other if cosine(frame, white[name], white[o]) > SAME_RHO)
        rivals = dict.fromkeys(klass[o] for o in near)
        out[name] = Likeness(tuple(rivals), tuple(alike))
    return out


def nominal_signatures(case: Investigation) -> dict[str, Float]:
    """Whitened signatures with the weights of the nominal model, which ``nominal_frame`` goes with.

    At the present base other rows may be kept, and a named effect is free there: nothing of its own signature is left.
    """
    problem, _ = case.prepared.settled(case.prepared.model)
    return dict(zip(case.signatures, problem.whitened_each([s.columns for s in case.signatures.values()]), strict=True))


def chance_of(case: Investigation, named: Candidate, like: Likeness, table: Posterior) -> tuple[float, float, float]:
    """How sure a named effect is, it or one that the data do not tell from it: probability, and its least and largest value."""
    alike = {named.klass, *like.names}
    return table.of_class(*(c.name for c in case.candidates if c.klass in alike))


def doubtful(case: Investigation, *, cut: bool = False) -> str | None:
    """The effect of those that stand that is least sure, where there are 19 to 1 against it in the sum; else None.

    What is said to be left over tells how sure others are.  Where the search was ``cut``, one of several that is less likely than
    not goes too: the last had no turn after it in which something else might have taken its place.
    """
    if not case.standing.effects:
        return None
    table, like = with_unknown(case).table, likenesses(case)
    chance = {c.name: chance_of(case, c, like[c.name], table)[0] for c in case.standing.effects}
    least = min(chance, key=lambda name: chance[name])
    return least if chance[least] < (LIKELY if cut and len(chance) > 1 else 1 / (1 + ODDS)) else None
