"""Speed of weighing by blocks as a ratio to one factor of all rows, for the sizes that a laboratory's plan falls into.

python -m tests.benchmarks --only weights
"""

import numpy as np
from scipy.linalg import block_diag
from timing import Row, side_by_side_ms

from isetval.loop.block_factor import factor

BLOCKS = (1144, 768, 768, 648, 288, *(38,) * 38, *(3,) * 93)  # rows of the blocks of two sessions of 57 shots, rounded
COLUMNS = 40  # unknowns that are whitened with them


def whole(covariance, columns):
    scale = np.sqrt(np.diag(covariance))
    return np.linalg.solve(np.linalg.cholesky(covariance / np.outer(scale, scale)), columns / scale[:, None])


def rows():
    """Lines of the table."""
    rng = np.random.default_rng(5)
    parts = [np.eye(n) + 0.1 * np.ones((n, n)) for n in BLOCKS]
    covariance, columns = block_diag(*parts), rng.standard_normal((sum(BLOCKS), COLUMNS))
    times = side_by_side_ms(
        {"whole": lambda: whole(covariance, columns), "blocks": lambda: factor(covariance).white(columns)}, repeats=3
    )
    cpu, wall = times["blocks"]
    return [Row(f"weights of {len(covariance)} rows: one factor over blocks", ">= 5", times["whole"][0] / cpu, cpu, wall)]
