"""Linear algebra of profiled tests: what remains of a signature when nuisances may answer for it.

Notation of Rao's score test with nuisance parameters profiled out: z whitened residual at the fitted
nuisances, N their whitened Jacobian with the priors as further rows, A the signature;
``dchi2 = z' P A (A' P A)^-1 A' P z`` with P the projector off the columns of N is chi2 with rank(A)
degrees of freedom under the null.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.loop.fit import Fit
from isetval.loop.gaussian import orthonormal_basis, prior_weights, with_priors

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Frame:
    """Residual and nuisance directions, with the priors as further rows.

    ``z`` is (rows + priors,), ``basis`` an orthonormal basis of the nuisances, ``rows`` the number of
    metric rows.
    """

    z: Float
    basis: Float
    rows: int

    def profiled(self, white: Float) -> Float:
        """P A for whitened metric columns (rows, k): what the nuisances cannot imitate."""
        tall = np.vstack([white, np.zeros((self.z.size - self.rows, white.shape[1]))])
        return np.asarray(tall - self.basis @ (self.basis.T @ tall))


def make_frame(fitted: Fit) -> Frame:
    """The frame of a fit."""
    matrix, priors = with_priors(fitted.jacobian, fitted.free)
    pulls = -prior_weights(fitted.free) * (fitted.values - np.array([f.center for f in fitted.free]))
    z = np.concatenate([fitted.z, pulls[priors]])
    q = orthonormal_basis(matrix)
    return Frame(z, q, fitted.z.size)


@dataclass(frozen=True, eq=False)
class Score:
    """Profiled score of one signature.

    ``estimate`` and ``sigma`` are the linear estimates of its parameters and their standard
    deviations; ``rank`` the number of directions that the data can see, ``information`` (k, k) what they say of the parameters.
    """

    dchi2: float
    rank: int
    p_value: float
    estimate: Float
    sigma: Float
    direction: Float
    information: Float

    def shows(self, tau: Float) -> bool:
        """Whether some direction of the parameters is better known than by priors of widths ``tau`` (k,).

        Light by field position has three numbers, of which charts at two places show one: none of the three is known then.
        """
        return bool(self.rank) and bool(np.linalg.eigvalsh(self.information * np.outer(tau, tau))[-1] > 1)


def score(frame: Frame, white: Float, *, side: float = 0.0) -> Score:
    """The profiled score of whitened signature columns (rows, k); ``side`` is 1 or -1 for one that only grows or falls."""
    from scipy.special import chdtrc  # as scipy.stats.chi2.sf, whose import takes .4 s

    part = frame.profiled(white)
    size = np.linalg.norm(part, axis=0)
    whole = np.linalg.norm(white, axis=0)
    seen = size > 1e-6 * np.maximum(whole, 1e-12)
    k = white.shape[1]
    estimate, sigma = np.zeros(k), np.full(k, np.inf)
    if not seen.any():
        return Score(0.0, 0, 1.0, estimate, sigma, np.zeros(frame.z.size), np.zeros((k, k)))
    u, s, vt = np.linalg.svd(part[:, seen] / size[seen], full_matrices=False)
    good = s > 1e-5 * s[0]
    u, s, vt = u[:, good], s[good], vt[good]
    along = u.T @ frame.z
    dchi2 = float(along @ along)
    estimate[seen] = (vt.T @ (along / s)) / size[seen]
    sigma[seen] = np.sqrt((vt.T**2) @ (1 / s**2)) / size[seen]
    rank = int(good.sum())
    p_value = float(chdtrc(rank, dchi2))
    if side and rank == 1:
        p_value = p_value / 2 if side * estimate[seen][0] > 0 else 1.0
    return Score(dchi2, rank, p_value, estimate, sigma, u @ along, np.asarray(part.T @ part))


def cosine(frame: Frame, a: Float, b: Float) -> float:
    """Largest cosine between the profiled signatures (worst direction, as canonical correlation)."""
    qa, qb = (_orthonormal(frame.profiled(x)) for x in (a, b))
    if qa.shape[1] == 0 or qb.shape[1] == 0:
        return 0.0
    return float(min(1.0, np.linalg.svd(qa.T @ qb, compute_uv=False)[0]))


def _orthonormal(part: Float) -> Float:
    size = np.linalg.norm(part, axis=0)
    part = part[:, size > 1e-9] / size[size > 1e-9]
    if part.shape[1] == 0:
        return part
    u, s, _ = np.linalg.svd(part, full_matrices=False)
    return np.asarray(u[:, s > 1e-5 * s[0]])
