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


def make_frame(fitted: Fit, *, without: tuple[str, ...] = ()) -> Frame:
    """The frame of a fit; ``without`` names free parameters that lose their prior and leave the nuisances."""
    keep = [i for i, f in enumerate(fitted.free) if not any(f.key.startswith(name) for name in without)]
    weight = np.array([0.0 if fitted.free[i].prior is None else 1 / fitted.free[i].prior for i in keep])  # type: ignore[operator]
    center = np.array([fitted.free[i].center for i in keep])
    priors = np.flatnonzero(weight)
    matrix = np.vstack([fitted.jacobian[:, keep], np.diag(weight)[priors]])
    pulls = -weight * (fitted.values[keep] - center)
    z = np.concatenate([fitted.z, pulls[priors]])
    q, r = np.linalg.qr(matrix) if keep else (np.zeros((z.size, 0)), np.zeros((0, 0)))
    size = np.abs(np.diag(r))
    q = q[:, size > 1e-10 * max(size.max(initial=0.0), 1e-300)]
    return Frame(z, q, fitted.z.size)


@dataclass(frozen=True, eq=False)
class Score:
    """Profiled score of one signature.

    ``estimate`` and ``sigma`` are the linear estimates of its parameters and their standard
    deviations; ``rank`` the number of directions that the data can see.
    """

    dchi2: float
    rank: int
    p_value: float
    estimate: Float
    sigma: Float
    direction: Float


def score(frame: Frame, white: Float, *, one_sided: bool = False) -> Score:
    """The profiled score of whitened signature columns (rows, k)."""
    from scipy.stats import chi2

    part = frame.profiled(white)
    size = np.linalg.norm(part, axis=0)
    whole = np.linalg.norm(white, axis=0)
    seen = size > 1e-6 * np.maximum(whole, 1e-12)
    k = white.shape[1]
    estimate, sigma = np.zeros(k), np.full(k, np.inf)
    if not seen.any():
        return Score(0.0, 0, 1.0, estimate, sigma, np.zeros(frame.z.size))
    u, s, vt = np.linalg.svd(part[:, seen] / size[seen], full_matrices=False)
    good = s > 1e-5 * s[0]
    u, s, vt = u[:, good], s[good], vt[good]
    along = u.T @ frame.z
    dchi2 = float(along @ along)
    estimate[seen] = (vt.T @ (along / s)) / size[seen]
    sigma[seen] = np.sqrt((vt.T**2) @ (1 / s**2)) / size[seen]
    rank = int(good.sum())
    p_value = float(chi2.sf(dchi2, rank))
    if one_sided and rank == 1:
        p_value = p_value / 2 if estimate[seen][0] > 0 else 1.0
    return Score(dchi2, rank, p_value, estimate, sigma, u @ along)


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
