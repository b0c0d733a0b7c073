"""The state of one investigation: what is believed, at which base it was weighed, and what may be believed instead."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.loop.block_factor import factor
from isetval.loop.candidates import Candidate, Doubt
from isetval.loop.evidence import Hypothesis, Member, fitted_members, hypothesis, linear_model, refit
from isetval.loop.fit import Fit, far_values
from isetval.loop.posterior import NOTHING, Names, Posterior
from isetval.loop.prediction import DERIVATIVE_SEEDS, NOISE_SEEDS, SPECIMEN_SEEDS, Point
from isetval.loop.prepared import Prepared
from isetval.loop.problem import Problem
from isetval.loop.result import CandidateRow, FormRow
from isetval.loop.score_test import Frame
from isetval.loop.signatures import Signature
from isetval.loop.steps import first_steps, first_values, with_steps
from isetval.loop.subset_sum import MAX_EFFECTS, Term, Weighed, weigh_all

Float = NDArray[np.float64]
SLIPS = (
    0.1  # odds that a laboratory is wrong about any of its unknowns, in units of an effect's: priors are stated by who measured
)
ODDS = 19.0  # 95 %: what a name needs against the same without it
BENDS = 0.5  # share of what a single effect explains that its signature may be wrong by: what the nuisances leave of it is small,
# and another form of it explains more (a vignetting of 6 %: 42 of 89 in ln Z)
WIDER_ROWS = (
    1.5  # scale of a family beyond which its error bars are not those of the hypothesis: 2.5 of the 20 % they are known to
)
CATCHES_UP = 3.0  # ln of the odds that a further name may be behind what stands and still be fitted to its end: chi2 of 2 where
# it needs 14.  Of one that shows with 5 sigmas the captures used say so little once in 3000
CLEAR = 13.8  # ln of a million: beyond it one session is enough, the other is asked where any two that may stand are closer
Say = Callable[[str], None]


@dataclass(frozen=True)
class Heard:
    """Of a close rival of what stands, when that was named: the hold-out's ``word`` beyond that of it, how far ``behind``."""

    word: float
    behind: float


@dataclass(eq=False)
class Investigation:
    """The state of one investigation.

    ``standing`` is what is believed; ``known`` are all hypotheses with the weights of the present ``problem``, among them those
    with a member of ``standing`` taken out, about which the sum is linearised (``rough``: not fitted yet); ``table`` is the
    sum over what the catalogue holds, each subset ``about`` the hypothesis that it was linearised at; ``promised`` is the same
    sum as derivatives alone have it; ``based`` are the effects at which the present ``problem`` was made.
    """

    prepared: Prepared
    held: Prepared | None
    problem: Problem
    standing: Hypothesis
    candidates: tuple[Candidate, ...]
    doubts: tuple[Doubt, ...]
    signatures: dict[str, Signature]
    nominal_frame: Frame
    known: dict[Names, Hypothesis] = field(default_factory=dict)
    linear: dict[Names, Weighed] = field(default_factory=dict)
    about: dict[Names, Names] = field(default_factory=dict)
    promised: dict[Names, float] = field(default_factory=dict)
    table: Posterior = field(default_factory=lambda: Posterior({NOTHING: 0.0}, {NOTHING: 0}))
    rough: set[Names] = field(default_factory=set)
    told: dict[Names, float] = field(default_factory=dict)
    heard: dict[Names, Heard] = field(default_factory=dict)
    rows: list[CandidateRow] = field(default_factory=list)
    unobservable: tuple[str, ...] = ()
    remarks: list[str] = field(default_factory=list)
    forms: dict[str, tuple[FormRow, ...]] = field(default_factory=dict)
    whitened: tuple[Problem | None, dict[str, Float]] = (None, {})
    based: tuple[Candidate, ...] = ()

    @property
    def fitted(self) -> Fit:
        """The joint fit of what is believed."""
        return self.standing.fitted

    @property
    def classes(self) -> int:
        """How many share the prior: the effects that would show, and the laboratory's slips as one."""
        return len({c.klass for c in self.candidates if c.name not in self.unobservable}) + bool(self.doubts)

    @property
    def doubt_share(self) -> float:
        """Prior odds of one doubt in units of an effect's."""
        return SLIPS / max(len(self.doubts), 1)

    @property
    def is_based(self) -> bool:
        """Whether the present problem was made at the effects that stand, in their forms."""
        return {id(m) for m in self.based} == {id(m) for m in self.standing.effects}

    def white(self) -> dict[str, Float]:
        """Whitened columns of every signature, with the weights of the present problem."""
        if self.whitened[0] is not self.problem:
            each = self.problem.whitened_each([s.columns for s in self.signatures.values()])
            self.whitened = (self.problem, dict(zip(self.signatures, each, strict=True)))
        return self.whitened[1]

    def log_prior(self, members: Sequence[Member]) -> float:
        """Ln of the prior odds of a hypothesis against nothing."""
        share = [m.prior_weight if isinstance(m, Candidate) else self.doubt_share for m in members]
        return float(np.sum(np.log(share)) - len(share) * np.log(max(self.classes, 1)))

    def score(self, found: Hypothesis) -> float:
        """ln(Z pi), absolute, with what the hold-out said (not asked: as much as of what stands)."""
        return found.log_evidence + self.log_prior(found.members) + self.told.get(found.names, 0.0)

    def word(self, names: Names, about: Names) -> float:
        """What the hold-out is taken to say of a set that is linear ``about`` another: what it once said, else what of that."""
        return self.heard[names].word if names in self.heard else self.told.get(about, 0.0)

    def member(self, name: str) -> Member:
        """The member of that name, in the form in which it stands if it does."""
        return next(m for m in (*self.standing.members, *self.candidates, *self.doubts) if m.name == name)


def asked_for(stands: Hypothesis, other: Hypothesis) -> bool:
    """Whether data ask for more names in the place of fewer: a form that fits as well does not give way for its length."""
    if not stands.names or len(other.names) <= len(stands.names) or other.names > stands.names:
        return True
    return stands.fitted.cost - other.fitted.cost > 2 * float(np.log(ODDS))


def named_model(nominal: CameraModel, found: Hypothesis) -> CameraModel:
    """The nominal model with the effects of a hypothesis at their values."""
    model = nominal
    for member in found.effects:
        values = {p.name: found.values[key] for p, key in zip(member.parameters, member.keys, strict=True)}
        model = model.with_effect(member.effect.changed(**values))
    return model


def terms_beside(case: Investigation, reference: Hypothesis) -> list[Term]:
    """What may be added to a hypothesis, as terms of the linear model about it, without what stands."""
    gone = {*case.unobservable, *reference.names, *case.standing.names}
    taken = {c.klass for c in reference.effects}
    white = case.white()
    terms = [
        Term(c.name, white[c.name], c.tau, c.side, c.klass, c.prior_weight)
        for c in case.candidates
        if c.name not in gone and c.klass not in taken
    ]
    labels = [f.label for f in reference.fitted.free]
    for doubt in case.doubts:
        if doubt.name not in gone and doubt.parameter.label in labels:
            column = reference.fitted.jacobian[:, [labels.index(doubt.parameter.label)]]
            width = doubt.loosened.reach
            terms.append(Term(doubt.name, column, np.array([width]), np.zeros(1), prior=case.doubt_share))
    return [t for t in terms if t.white.any()]


def weigh_neighbours(case: Investigation) -> None:
    """Make the sum about what stands and about what is left of it when members are taken out, with the same weights."""
    logs: dict[Names, float] = {}
    freed: dict[Names, int] = {}
    case.linear, case.about = {}, {}
    for reference in _references(case):
        terms = terms_beside(case, reference)
        largest = max(MAX_EFFECTS - len(reference.members), 0)
        found, own = weigh_all(linear_model(case.problem, reference.fitted, terms), classes=max(case.classes, 1), largest=largest)
        base = case.log_prior(reference.members)
        count = sum(len(m.keys) for m in reference.members)
        for subset, value in found.items():
            names = reference.names | {terms[i].name for i in subset}
            logs[names] = value + base + case.word(names, reference.names)
            freed[names] = count + sum(terms[i].tau.size for i in subset)
            case.about[names] = reference.names
        case.linear |= {reference.names | {terms[i].name for i in s}: w for s, w in own.items()}
    case.promised = logs
    case.table = Posterior(logs | {names: case.score(h) for names, h in case.known.items() if names in logs}, freed)


def _references(case: Investigation) -> list[Hypothesis]:
    """What stands, each part of it with one member taken out, and nothing, with the weights of the present problem.

    The parts are linearised where the nuisances of what stands are; a part that turns out to be likely is fitted in full.
    """
    stands = case.standing.members
    parts = [stands, *([m for m in stands if m is not gone] for gone in stands), ()]
    out: dict[Names, Hypothesis] = {}
    for part in parts:
        names = frozenset(m.name for m in part)
        if names not in case.known:
            near = case.standing
            values = {key: near.values[key] for m in part for key in m.keys}
            sigma = {key: near.value(key)[1] for m in part for key in m.keys}
            case.known[names] = refit(
                case.problem, case.prepared.model, near, list(part), values, _steps(part, values, sigma), iterations=0
            )
            case.rough.add(names)
        out[names] = case.known[names]
    return list(out.values())


def _steps(members: Sequence[Member], values: dict[str, float], sigma: Mapping[str, float] | None = None) -> dict[str, float]:
    return {key: h for m in members if isinstance(m, Candidate) for key, h in first_steps(m, values, sigma).items()}


def draws_of(members: Sequence[Member]) -> tuple[int, ...]:
    """Seeds over which differences are taken where these members are."""
    drawn = [m.effect for m in members if isinstance(m, Candidate) and m.effect.random != "none"]
    if any(effect.counted for effect in drawn):
        return SPECIMEN_SEEDS
    return NOISE_SEEDS if any(effect.draws_normals for effect in drawn) else DERIVATIVE_SEEDS


def fitted_jointly(case: Investigation, names: Names) -> Hypothesis:
    """A subset of the sum fitted in full, from where the linear model puts it."""
    shared = names & case.standing.names
    reference = case.known[shared if shared in case.known else NOTHING]
    members = [case.member(name) for name in sorted(names)]
    values = dict(reference.values)
    weighed = case.linear.get(names)
    added, sigma = _added_values(case, reference, names, weighed) if weighed is not None else ({}, {})
    sigma |= {key: reference.value(key)[1] for m in reference.effects for key in m.keys}
    for m in members:
        if isinstance(m, Candidate) and m.name not in reference.names:
            start = added.get(m.name, np.zeros(len(m.keys)))
            values |= first_values(m, case.signatures[m.name], start)
    values = {key: values[key] for m in members for key in m.keys}
    steps = _steps(members, values, sigma)
    drawn = any(isinstance(m, Candidate) and m.effect.counted and m.name not in reference.names for m in members)
    promised = weighed.log_evidence if weighed is not None and drawn else None
    best = max(h.log_evidence + case.log_prior(h.members) for h in case.known.values())
    useful = max(best - CLEAR, _catches_up(case, members))
    beaten = useful - case.log_prior(members) if promised is None else -np.inf
    problem = case.problem if drawn else case.problem.with_draws(draws_of(members))
    found = refit(problem, case.prepared.model, reference, members, values, steps, promised, beaten=beaten)
    if (
        any(m.goes_as_square for m in found.effects if m.name not in case.standing.names)
        and found.weighed.scales.max() > WIDER_ROWS
    ):
        found = _at_its_own_weights(case, found)
    case.known[names] = found
    case.rough.discard(names)
    return found


def _catches_up(case: Investigation, members: Sequence[Member]) -> float:
    """The least ln(Z pi) of what stands and more from which the hold-out may still make it stand; -inf where no start tells.

    Variances go as the square of a noise and whole codes in stairs: there derivatives promise nothing of what is to be found.
    """
    more = [m for m in members if m.name not in case.standing.names]
    blind = any(isinstance(m, Candidate) and (m.effect.random != "none" or m.code_steps) for m in more)
    if blind or not {m.name for m in members} > case.standing.names:
        return -np.inf
    return case.standing.log_evidence + case.log_prior(case.standing.members) - CATCHES_UP


def _at_its_own_weights(case: Investigation, found: Hypothesis) -> Hypothesis:
    """The hypothesis with the evidence and the values that the covariance of its own prediction gives it.

    Strong noise widens all rows that it is in: ln N(y; f, C) with C of a camera without it calls what it scatters a misfit, and
    the scales of those families answer for it in place of its name.  ln det C is what wider rows cost.
    """
    model = named_model(case.prepared.model, found)
    problem = case.prepared.problem_for(model, seeds=draws_of(found.members), values=far_values(found.fitted))
    problem.take_over(case.problem)
    free = with_steps(found.fitted.free, found.members, found.values)
    fitted = fitted_members(problem, found.members, Point(model, found.fitted.point.values), free, pose=found.fitted.pose)
    own = hypothesis(problem, found.members, fitted)
    common = np.intersect1d(problem.keep, case.problem.keep)
    wider = [factor(p.covariance, common).log_volume for p in (problem, case.problem)]
    return replace(found, log_evidence=own.log_evidence - (wider[0] - wider[1]) / 2, values=own.values)


def _added_values(
    case: Investigation, reference: Hypothesis, names: Names, weighed: Weighed
) -> tuple[dict[str, Float], dict[str, float]]:
    """What a subset adds to its reference as the linear model has it.

    Values by name, in units of the priors' widths; sigmas by key.
    """
    sigma = np.sqrt(np.diag(weighed.covariance))
    values: dict[str, Float] = {}
    sigmas: dict[str, float] = {}
    place = len(reference.fitted.free)
    for term in terms_beside(case, reference):
        if term.name in names:
            own = slice(place, place + term.tau.size)
            values[term.name] = weighed.values[own]
            if keys := case.member(term.name).keys:
                sigmas |= dict(zip(keys, map(float, term.tau * sigma[own]), strict=True))
            place += term.tau.size
    return values, sigmas
