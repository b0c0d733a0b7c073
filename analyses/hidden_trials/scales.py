"""How well error bars of a family are known: the scatter of its mean-square z over campaigns of the true model.

Of a true model a mean-square z of n numbers whose variance is known to nu degrees of freedom is F of (n, nu).
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from scipy.stats import f

DOF = (25, 50, 100, 200, 500, 1000)
NUMBERS_A_ROW = {"mtf": 0.42}  # of the full plan, as its replicas show them (`isetval.loop.weighing`); one of other families
LEAST_SESSIONS = 10  # of fewer no scatter is known


def scale_lines(rows):
    """A line a family: ln L of each `DOF` less that of the likeliest of them; ``rows`` are trial rows, of which nulls count."""
    found, numbers = defaultdict(list), {}
    for row in rows:
        for entry in (row["answer"] or {}).get("ladder", ()) if row["kind"] == "null" else ():
            if entry["model"].count("+") == 0 and entry["family"] != "all":
                found[entry["family"]].append(entry["mean_square_z"])
                numbers[entry["family"]] = entry["n"] * NUMBERS_A_ROW.get(entry["family"], 1.0)
    lines = [f"{'ln L of the dof of a scale, below the likeliest':34s} {'sessions':>8s}" + "".join(f"{d:>8d}" for d in DOF)]
    for family, values in sorted(found.items()):
        own = np.array(values)
        if own.size < LEAST_SESSIONS or not own.all():
            continue
        logs = np.array([np.sum(f.logpdf(own / own.mean(), numbers[family], dof)) for dof in DOF])
        lines.append(f"{family:34s} {own.size:8d}" + "".join(f"{value:8.1f}" for value in logs - logs.max()))
    return lines
