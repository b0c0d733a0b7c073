"""The evidence of something unknown, beside what is named or in its place.

``y = N nu + A theta + u + e``: u is a pattern without physics (`isetval.loop.unknown.templates`) of unknown amplitude in
one metric family, or scatter of all rows of a family; in both sessions alike, or in one of them.  See ``docs/detective.md``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.loop.subset_sum import LinearModel, at_scales

Float = NDArray[np.float64]
AMPLITUDES: Float = np.array([0.5, 1, 2, 4, 8, 16, 32, 64])
"""Sigmas that u shows with, each as likely: from what nobody sees to what nobody overlooks."""
SEEN = 1e-3  # share of a pattern's squared length that all that is free leaves, below which it cannot be told from that
DENIED = 4.0
"""Mean square that a fit leaves of a family, from which on it scatters by what it leaves: five numbers of a true model show
more in 1 of 1000.  Derivatives that promise to mend it are those that the full model has denied (places of edges by a
shift of colors that blurs them as well)."""
SCATTERS = "scatters more than stated"
OF_SPECIMEN = ("_fixed_", "_outliers", "_noisy_pixels")
"""In names of families whose numbers are those of one specimen, the same in both sessions: what stands out in one by chance does
so in the other, and is no second word."""
BOTH, HERE, THERE = "both sessions", "the captures used", "the hold-out"
Kind = tuple[str, str]


@dataclass(frozen=True, eq=False)
class Patterns:
    """Whitened patterns (rows, m) of one session, with their words and families."""

    words: tuple[str, ...]
    families: NDArray[np.str_]
    white: Float


@dataclass(frozen=True, eq=False)
class Left:
    """What a hypothesis leaves in one session along one pattern, or as scatter of one family.

    ``along`` is the projection of the residual on the pattern and ``square`` the pattern's squared length, all that is free
    profiled out; for scatter ``along`` is the sum of squares and ``square`` is 0.  ``number`` counts directions; ``lift`` is
    ln Z of the hypothesis with the scale of the family at 1, less that at its own: scatter is then the unknown's.
    """

    along: float
    square: float
    number: float
    lift: float


def left_by(model: LinearModel, scales: Float, patterns: Patterns) -> dict[str, Left]:
    """What a hypothesis leaves, by words; all that is free in it are the nuisances of ``model``."""
    names = list(dict.fromkeys(model.families))
    place = np.array([names.index(f) for f in model.families])
    stands = at_scales(model, (), scales).log_evidence
    out: dict[str, Left] = {}
    for i, name in enumerate(names):
        own = np.where(np.arange(len(names)) == i, 1.0, scales)
        weighed = at_scales(model, (), own)
        weight = 1 / np.sqrt(own[place])[:, None]
        mine = np.flatnonzero(patterns.families == name)
        x, t = model.nuisances * weight, patterns.white[:, mine] * weight
        residual = model.z * weight[:, 0] - x @ weighed.values
        cross, whole = x.T @ t, np.sum(t**2, axis=0)
        square = whole - np.einsum("ij,ik,kj->j", cross, weighed.covariance, cross)
        lift = weighed.log_evidence - stands
        for j, a, s, w in zip(mine, t.T @ residual, square, whole, strict=True):
            if s > SEEN * w:
                out[patterns.words[j]] = Left(float(a), float(s), 1.0, lift)
        rows = place == i
        number = model.counts[i] - float(np.einsum("ij,jk,ik->", x[rows], weighed.covariance, x[rows]))
        if number > 1:
            scatter, as_it_is = float(residual[rows] @ residual[rows]), float(model.z[rows] @ model.z[rows])
            if as_it_is > DENIED * model.counts[i]:
                scatter, lift = as_it_is, at_scales(model, (), own, fitted=True).log_evidence - stands
            out[f"{name} {SCATTERS}"] = Left(scatter, 0.0, number, lift)
    return out


def log_mixture(gain: Float, number: Float, amplitudes: Float = AMPLITUDES) -> Float:
    """Ln of the evidence (k,) of ``number`` directions that take at most ``gain`` (k,) of chi2 away; 0 is that of none.

    ``ln Z(a) = gain/2 a^2/(1 + a^2) - number/2 ln(1 + a^2)``, each amplitude a (sigmas) as likely.
    """
    from scipy.special import logsumexp

    power = np.asarray(amplitudes)[:, None] ** 2
    logs = gain / 2 * power / (1 + power) - number / 2 * np.log1p(power)
    return np.asarray(logsumexp(logs, axis=0) - np.log(len(power)))


@dataclass(frozen=True, eq=False)
class Unknown:
    """Every kind of unknown beside a hypothesis: by how much it lowers chi2 at most, in how many directions, its ``lift``."""

    kinds: tuple[Kind, ...]
    gain: Float
    number: Float
    lift: Float

    @classmethod
    def of(cls, here: Mapping[str, Left], there: Mapping[str, Left]) -> Unknown:
        """From what is left in the captures used and in the hold-out (empty: there is none)."""
        found = [((words, where), _alone(left)) for where, part in ((HERE, here), (THERE, there)) for words, left in part.items()]
        both = [words for words in here if words in there and not _is_of_specimen(words)]
        found += [((words, BOTH), _together(here[words], there[words])) for words in both]
        gain, number, lift = np.array([row for _, row in found]).reshape(-1, 3).T
        return cls(tuple(kind for kind, _ in found), gain, number, lift)

    def log_evidence(self, amplitudes: Float = AMPLITUDES) -> float:
        """Ln of the evidence with something unknown for that of the hypothesis alone."""
        from scipy.special import logsumexp

        return float(logsumexp(self._logs(amplitudes))) if self.kinds else -np.inf

    def likeliest(self) -> list[tuple[Kind, float]]:
        """The kinds with their share of the evidence, the largest first."""
        logs = self._logs(AMPLITUDES)
        weight = np.exp(logs - logs.max(initial=-np.inf))
        return sorted(zip(self.kinds, map(float, weight / weight.sum()), strict=True), key=lambda item: -item[1])

    def _logs(self, amplitudes: Float) -> Float:
        return np.asarray(log_mixture(self.gain, self.number, amplitudes) + self.lift + np.log(_shares(self.kinds)))


def _is_of_specimen(words: str) -> bool:
    return any(part in words.split()[0] for part in OF_SPECIMEN)


def _alone(left: Left) -> tuple[float, float, float]:
    return (left.along**2 / left.square if left.square else left.along, left.number, left.lift)


def _together(a: Left, b: Left) -> tuple[float, float, float]:
    """One pattern with one amplitude in both sessions, or scatter of one size."""
    if a.square:
        return (a.along + b.along) ** 2 / (a.square + b.square), 1.0, a.lift + b.lift
    return a.along + b.along, a.number + b.number, a.lift + b.lift


def _shares(kinds: Sequence[Kind]) -> Float:
    """Prior share (k,) of each kind: patterns and scatter alike, both sessions and each alone alike."""
    groups = [(words.endswith(SCATTERS), where) for words, where in kinds]
    counts = {group: groups.count(group) for group in set(groups)}
    return np.array([1 / (len(counts) * counts[group]) for group in groups])
