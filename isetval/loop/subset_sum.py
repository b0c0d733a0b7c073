"""One linear model for everything that may be missing, and the sum over its subsets.

Whitened residuals are ``y = N nu + sum_k s_k A_k theta_k + e``: nuisances nu under the campaign's priors, effects k in
(s_k = 1) or out, theta_k ~ N(0, tau_k^2) (half of it where a parameter can only grow), rows of metric family f with
variance lambda_f, which is known only as well as stated error bars are (`family_scales`).  Nuisances and theta are integrated
in closed form, lambda by Laplace, which is exact for the Student t that it gives.  See ``docs/detective.md``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from isetval.loop.family_scales import SCALE_SETTLED, SCALE_TURNS, dof_of

Float = NDArray[np.float64]
Subset = tuple[int, ...]
BEAM = 24  # subsets of a size that get scales of their own and are grown: the prior odds of each step leave the rest far below
MAX_EFFECTS = 4  # in one diagnosis: a model that lacks more is better mended step by step


@dataclass(frozen=True, eq=False)
class Term:
    """One member of the sum: whitened columns (rows, k) per unit of its parameters, their prior widths (k,).

    ``side`` (k,) is 1 for parameters that can only grow, -1 for those that can only fall, 0 for others; ``klass`` is the name
    that it counts under (the forms of an effect share one), of which a subset holds one member; ``prior`` multiplies the
    prior odds of its class.
    """

    name: str
    white: Float
    tau: Float
    side: Float
    klass: str = ""
    prior: float = 1.0

    @property
    def group(self) -> str:
        """The class that it counts under."""
        return self.klass or self.name


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Data of the sum: residual ``z`` and columns of all that is free in every subset (rows, p), whitened; families of the rows.

    Those columns are per prior sigma, or per any unit where there is none (``held`` (p,) False); ``pulls`` (p,) is where
    they stand, prior sigmas off; ``side`` (p,) says which can only grow or fall.  ``scale_dof`` (families,) says how well their
    error bars are known, where not `dof_of` does; ``numbers`` how many numbers their rows hold, where not one each
    (`isetval.loop.family_scales.Families`).
    """

    z: Float
    nuisances: Float
    held: NDArray[np.bool_]
    pulls: Float
    side: Float
    families: NDArray[np.str_]
    terms: tuple[Term, ...]
    scale_dof: Float | None = None
    numbers: Mapping[str, float] = field(default_factory=dict)
    grams: Float = field(init=False)
    counts: Float = field(init=False)
    prior: Float = field(init=False)
    dof: Float = field(init=False)
    places: tuple[NDArray[np.intp], ...] = field(init=False)

    def __post_init__(self) -> None:
        ends = np.cumsum([0, *(t.tau.size for t in self.terms)]) + self.held.size
        scaled = [t.white * t.tau for t in self.terms]
        x = np.column_stack([self.nuisances, *scaled, self.z])
        names = list(dict.fromkeys(self.families))
        parts = [x[self.families == name] for name in names]
        p, total = self.held.size, x.shape[1]
        prior = np.zeros((total, total))
        prior[range(p), range(p)] = self.held
        prior[range(p, total - 1), range(p, total - 1)] = 1.0
        prior[:p, -1] = prior[-1, :p] = -self.pulls
        prior[-1, -1] = float(self.pulls @ self.pulls)
        object.__setattr__(self, "grams", np.array([part.T @ part for part in parts]))
        counts = [self.numbers.get(name, float(len(part))) for name, part in zip(names, parts, strict=True)]
        object.__setattr__(self, "counts", np.array(counts))
        object.__setattr__(self, "prior", prior)
        object.__setattr__(self, "dof", dof_of(names) if self.scale_dof is None else self.scale_dof)
        object.__setattr__(self, "places", tuple(np.arange(a, b) for a, b in pairwise(ends)))

    def columns(self, subset: Subset) -> NDArray[np.intp]:
        """Places of the nuisances' and of a subset's columns."""
        return np.concatenate([np.arange(self.held.size), *(self.places[i] for i in subset)])


@dataclass(frozen=True, eq=False)
class Weighed:
    """A subset with ln Z, and at its most probable scales: ``values`` (p + k,) and ``covariance`` of what is free in it.

    Nuisances first, as steps from where the model stands; then the parameters of the terms in units of their tau.
    """

    subset: Subset
    log_evidence: float
    values: Float
    covariance: Float
    scales: Float


def weigh(model: LinearModel, subset: Subset, scales: Float | None = None, *, fitted: bool = False) -> Weighed:
    """Evidence of one subset, its scales at their most probable values (absolute: nothing is taken off).

    ``fitted`` says that the model was linearised at the bottom, where everything free in it stands: what its derivatives
    promise beyond, the full model has denied (derivatives of whole codes may promise everything).
    """
    use = model.columns(subset)
    scales = np.ones(model.counts.size) if scales is None else scales
    dof, counts = model.dof, model.counts
    pick, last = np.ix_(use, use), -1
    inner = np.array([gram[pick] for gram in model.grams])
    cross, square = model.grams[:, use, last], model.grams[:, last, last]
    for _ in range(SCALE_TURNS):
        hessian = np.tensordot(1 / scales, inner, 1) + model.prior[pick]
        inverse = np.linalg.inv(hessian)
        x = np.zeros(use.size) if fitted else inverse @ (cross.T @ (1 / scales) + model.prior[use, last])
        inside = np.einsum("fij,i,j->f", inner, x, x)
        left = square - 2 * cross @ x + inside + np.einsum("fij,ij->f", inner, inverse)
        new = (dof + left) / (dof + counts)
        settled = np.max(np.abs(new / scales - 1)) < SCALE_SETTLED
        scales = new
        if settled:
            break
    return at_scales(model, subset, scales, fitted=fitted)


def at_scales(model: LinearModel, subset: Subset, scales: Float, *, fitted: bool = False) -> Weighed:
    """Evidence of one subset at given scales of the families."""
    p = model.held.size
    use, last = model.columns(subset), -1
    total = np.tensordot(1 / scales, model.grams, 1) + model.prior
    hessian, cross = total[np.ix_(use, use)], total[use, last]
    inverse = np.linalg.inv(hessian)
    x = np.zeros(use.size) if fitted else inverse @ cross
    cost = total[last, last] - cross @ x
    log_z = -0.5 * cost - 0.5 * float(np.linalg.slogdet(hessian)[1])
    log_z -= 0.5 * float(np.sum(model.counts * np.log(scales) + model.dof * (np.log(scales) + 1 / scales - 1)))
    side = np.concatenate([model.side, *(model.terms[i].side for i in subset)])
    stands = x + np.concatenate([model.pulls, np.zeros(use.size - p)])
    log_z += float(np.sum(log_half(side * stands, np.diag(inverse))[side != 0]))
    return Weighed(subset, float(log_z), x, np.asarray(inverse), scales)


def log_half(mean: Float, variance: Float) -> Float:
    """Ln of what a half-normal prior makes of the evidence of a normal one: twice the probability of the right side."""
    from scipy.special import log_ndtr

    return np.asarray(np.log(2.0) + log_ndtr(mean / np.sqrt(variance)))


@dataclass(frozen=True, eq=False)
class _Reduced:
    """The sum at fixed scales with the nuisances integrated: Gram (k + 1, k + 1) of all terms' columns, the last one empty."""

    gram: Float
    cross: Float
    side: Float
    places: NDArray[np.intp]

    @classmethod
    def of(cls, model: LinearModel, scales: Float) -> _Reduced:
        total = np.tensordot(1 / scales, model.grams, 1) + model.prior
        p, k = model.held.size, total.shape[0] - 1 - model.held.size
        solved = np.linalg.solve(total[:p, :p], total[:p, p:]) if p else np.zeros((0, k + 1))
        left = total[p:, p:] - total[p:, :p] @ solved
        gram, cross = np.eye(k + 1), np.zeros(k + 1)
        gram[:k, :k], cross[:k] = left[:k, :k], left[:k, -1]
        width = max((t.tau.size for t in model.terms), default=1)
        places = np.full((len(model.terms), width), k)
        for row, own in zip(places, model.places, strict=True):
            row[: own.size] = own - p
        side = np.concatenate([*(t.side for t in model.terms), [0.0]])
        return cls(gram, cross, side, places)

    def log_evidences(self, subsets: NDArray[np.intp]) -> Float:
        """ln(Z / Z of nothing) of many subsets (n, size) at once."""
        use = self.places[subsets].reshape(len(subsets), -1)
        empty = use == self.gram.shape[0] - 1
        matrix = self.gram[use[:, :, None], use[:, None, :]]
        both = empty[:, :, None] | empty[:, None, :]
        matrix = np.where(both, np.eye(use.shape[1]), matrix)
        inverse = np.linalg.inv(matrix)
        cross = self.cross[use]
        mean = np.einsum("nij,nj->ni", inverse, cross)
        variance = np.einsum("nii->ni", inverse)
        side = self.side[use]
        half = np.where(side != 0, log_half(side * mean, variance), 0.0)
        return np.asarray(0.5 * np.sum(cross * mean, axis=1) - 0.5 * np.linalg.slogdet(matrix)[1] + half.sum(axis=1))


def weigh_all(
    model: LinearModel, *, classes: int, largest: int = MAX_EFFECTS
) -> tuple[dict[Subset, float], dict[Subset, Weighed]]:
    """Ln(Z pi) of nothing, every single effect, every pair, and larger subsets grown from the best.

    Parameters
    ----------
    classes : int
        Number of classes that share the prior: each is in with odds of one to it.
    largest : int
        Effects in the largest subset.

    Returns
    -------
    dict
        Of all subsets, absolute (only differences mean anything).
    dict
        Those that were weighed at scales of their own.

    Notes
    -----
    All subsets of a size are first weighed at the scales of the best subset found so far, in one batch; the best `BEAM`
    of them then at scales of their own, and those are grown by one more effect.
    """
    groups = [t.group for t in model.terms]
    odds = [float(np.log(t.prior / classes)) for t in model.terms]
    found: dict[Subset, Weighed] = {(): weigh(model, ())}
    logs: dict[Subset, float] = {(): found[()].log_evidence}
    best, seeds = found[()], list(found)
    for size in range(1, min(largest, len(set(groups))) + 1):
        grown = _grown(seeds, groups)
        if not grown:
            break
        prior = np.array([sum(odds[i] for i in s) for s in grown])
        values = _screened(model, best, np.array(grown)) + prior
        logs |= dict(zip(grown, map(float, values), strict=True))
        order = np.argsort(-values)[:BEAM]
        for j in order:
            found[grown[j]] = weigh(model, grown[j], best.scales)
            logs[grown[j]] = found[grown[j]].log_evidence + float(prior[j])
        best = found[max(found, key=lambda s: logs[s])]
        seeds = grown if size == 1 else [grown[j] for j in order]
    return logs, found


def best_with(model: LinearModel, first: int) -> Float:
    """Ln Z (first,) of each of the ``first`` terms, alone or with the best of the terms after them.

    At the scales of the best of these, found in turns as those of one subset are (`weigh`).
    """
    after = range(first, len(model.terms))
    pairs = np.array([(i, j) for i in range(first) for j in after])
    best = weigh(model, ())
    for _ in range(SCALE_TURNS):
        alone = _screened(model, best, np.arange(first)[:, None])
        both = _screened(model, best, pairs).reshape(first, -1) if pairs.size else alone[:, None]
        found = np.maximum(alone, both.max(axis=1))
        i = int(np.argmax(found))
        subset = (i,) if alone[i] >= both[i].max() else (i, int(pairs.reshape(first, -1, 2)[i, int(np.argmax(both[i])), 1]))
        if subset == best.subset:
            break
        best = weigh(model, subset, best.scales)
    return np.asarray(found)


def _grown(seeds: Sequence[Subset], groups: Sequence[str]) -> list[Subset]:
    """Every seed with one more effect of a class that it does not hold."""
    return sorted({tuple(sorted((*s, i))) for s in seeds for i, g in enumerate(groups) if g not in {groups[j] for j in s}})


def _screened(model: LinearModel, best: Weighed, subsets: NDArray[np.intp]) -> Float:
    """Ln Z of many subsets at the scales of ``best``, with what those scales cost."""
    fixed = at_scales(model, (), best.scales).log_evidence
    return _Reduced.of(model, best.scales).log_evidences(subsets) + fixed
