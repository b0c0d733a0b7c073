"""Probabilities of everything that may be missing together: the sum over subsets, gathered from several linear models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Names = frozenset[str]
NOTHING: Names = frozenset()
UNKNOWN = "something unknown"
WIDTH_SCAN = 3.0  # prior widths are plausible scales, known to about this factor


def like(name: str) -> str:
    """The member that is something unknown which looks like an effect."""
    return f"{UNKNOWN}, like {name}"


@dataclass(frozen=True, eq=False)
class Posterior:
    """Subsets of names with ln(Z pi), absolute, and how many parameters each frees."""

    logs: Mapping[Names, float]
    freed: Mapping[Names, int]

    @property
    def ranked(self) -> list[Names]:
        """All subsets, the most probable first."""
        return sorted(self.logs, key=lambda s: -self.logs[s])

    def probabilities(self, width: float = 1.0) -> dict[Names, float]:
        """Of every subset, with all prior widths ``width`` times as wide (Lindley 1957: 1/width for each parameter)."""
        subsets = list(self.logs)
        logs, freed = (np.array([table[s] for s in subsets], float) for table in (self.logs, self.freed))
        logs = logs - freed * np.log(width)
        weight = np.exp(logs - logs.max())
        return dict(zip(subsets, map(float, weight / weight.sum()), strict=True))

    @cached_property
    def _of_each(self) -> dict[str, float]:
        """Probability that each name is missing, whatever else is: a diagnosis asks for all of them, one by one."""
        found: dict[str, float] = {}
        for subset, chance in self.probabilities().items():
            for name in subset:
                found[name] = found.get(name, 0.0) + chance
        return {name: min(1.0, chance) for name, chance in found.items()}

    @property
    def nothing(self) -> float:
        """Probability that nothing is missing."""
        return self.probabilities().get(NOTHING, 0.0)

    @property
    def unknown(self) -> float:
        """Probability that something unknown is at work, beside what is named or in its place."""
        return min(1.0, float(sum(p for s, p in self.probabilities().items() if any(n.startswith(UNKNOWN) for n in s))))

    def log_rest(self, names: Names) -> float:
        """Ln of how much more probable it is that anything is missing than that exactly these are."""
        chances = self.probabilities()
        return float(np.log1p(-chances.get(NOTHING, 0.0)) - np.log(chances[names])) if chances.get(names, 0.0) > 0 else 0.0

    def of(self, *names: str, width: float = 1.0) -> float:
        """Probability that one or more of these are missing, whatever else is."""
        if len(names) == 1 and width == 1.0:
            return self._of_each.get(names[0], 0.0)
        return min(1.0, float(sum(p for s, p in self.probabilities(width).items() if s & set(names))))

    def of_class(self, *names: str) -> tuple[float, float, float]:
        """Probability of a class, and its range when all prior widths are three times narrower or wider."""
        found = [self.of(*names, width=w) for w in (1.0, 1 / WIDTH_SCAN, WIDTH_SCAN)]
        return found[0], min(found), max(found)
