"""Ray-transfer polynomials: reading their terms once and evaluating them fast on blocks of rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from isetval.core.errors import InputError

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

OUTPUTS = ("outx", "outy", "outz", "outdx", "outdy", "outdz")


@dataclass(frozen=True, eq=False)
class OutputPolynomial:
    """One output as a polynomial in field height r, dx and dy (after rotation into the meridian).

    Attributes
    ----------
    exponents : (terms, 3) int
        Powers of r (mm), dx and dy of every term.
    coefficients : (terms,) float
        Coefficients in mm (positions) or 1 (direction cosines) per mm^power of r.
    """

    exponents: IntArray
    coefficients: FloatArray

    @property
    def degree(self) -> int:
        """Highest total power of any term."""
        return int(self.exponents.sum(axis=1).max(initial=0))

    def mirror_parity(self) -> IntArray:
        """Parity of dx in each term, (terms,): 1 where the term changes sign under x -> -x."""
        return self.exponents[:, 1] % 2


def full_terms(degree: int) -> IntArray:
    """All powers (r, dx, dy) up to a total degree, in the order of the ISET files, (terms, 3)."""
    rows = [(i, j, k) for i in range(degree, -1, -1) for j in range(degree - i, -1, -1) for k in range(degree - i - j, -1, -1)]
    return np.array(rows, dtype=np.int64)


def _closed_terms(exponents: Sequence[tuple[int, int, int]]) -> list[tuple[int, int, int]]:
    """Terms with every missing ancestor (one power less), lowest degree first."""
    seen: set[tuple[int, int, int]] = set()

    def add(term: tuple[int, int, int]) -> None:
        if term in seen or not any(term):
            return
        add(_parent(term)[0])
        seen.add(term)

    for term in exponents:
        add(term)
    return sorted(seen, key=lambda t: (sum(t), t))


def _parent(term: tuple[int, int, int]) -> tuple[tuple[int, int, int], int]:
    """The term with one power less, and the variable (0 r, 1 dx, 2 dy) that leads back."""
    axis = next(a for a in (2, 1, 0) if term[a])
    lower = list(term)
    lower[axis] -= 1
    return (lower[0], lower[1], lower[2]), axis


class PolynomialSet:
    """Several polynomials in the same three variables, evaluated together.

    Every monomial is one product of a lower monomial and a variable; all outputs are then one small
    matrix product per block of rays, small enough to stay in the cache.
    """

    def __init__(self, polynomials: Sequence[OutputPolynomial]) -> None:
        wanted = sorted({(int(i), int(j), int(k)) for p in polynomials for i, j, k in p.exponents})
        terms = _closed_terms(wanted)
        row = {term: i for i, term in enumerate(terms)}
        row[(0, 0, 0)] = len(terms)
        self.rows = len(terms) + 1
        self.steps = [(row[t], None if not any(_parent(t)[0]) else row[_parent(t)[0]], _parent(t)[1]) for t in terms]
        self.matrix = np.zeros((len(polynomials), self.rows))
        for out, p in enumerate(polynomials):
            for (i, j, k), c in zip(p.exponents, p.coefficients, strict=True):
                self.matrix[out, row[(int(i), int(j), int(k))]] += c

    def workspace(self, rays: int) -> FloatArray:
        """Scratch for blocks of this many rays, (rows, rays)."""
        scratch = np.empty((self.rows, rays))
        scratch[-1] = 1.0
        return scratch

    def evaluate_block(self, r: FloatArray, dx: FloatArray, dy: FloatArray, scratch: FloatArray) -> FloatArray:
        """Outputs, (outputs, rays), for one block; ``scratch`` comes from `workspace`."""
        n = r.size
        variables = (r, dx, dy)
        for target, source, axis in self.steps:
            if source is None:
                scratch[target, :n] = variables[axis]
            else:
                np.multiply(scratch[source, :n], variables[axis], out=scratch[target, :n])
        return self.matrix @ scratch[:, :n]

    def evaluate(self, r: npt.ArrayLike, dx: npt.ArrayLike, dy: npt.ArrayLike, *, block: int = 4096) -> FloatArray:
        """Outputs, (outputs, rays), for flat arrays of rays of any length."""
        r_, dx_, dy_ = (np.ravel(np.asarray(v, dtype=np.float64)) for v in np.broadcast_arrays(r, dx, dy))
        out = np.empty((len(self.matrix), r_.size))
        scratch = self.workspace(min(block, max(r_.size, 1)))
        for start in range(0, r_.size, block):
            part = slice(start, start + block)
            out[:, part] = self.evaluate_block(r_[part], dx_[part], dy_[part], scratch)
        return out


@dataclass(frozen=True, eq=False)
class RayPolynomials:
    """The six polynomials of one wavelength, keyed by the output names of the ISET files."""

    outputs: dict[str, OutputPolynomial]

    def __post_init__(self) -> None:
        missing = [name for name in OUTPUTS if name not in self.outputs]
        if missing:
            raise InputError(f"ray-transfer polynomials lack {', '.join(missing)}; all of {', '.join(OUTPUTS)} are needed")

    @cached_property
    def transverse(self) -> PolynomialSet:
        """outx, outy, outdx, outdy together: all that tracing needs besides a constant outz."""
        return PolynomialSet([self.outputs[name] for name in ("outx", "outy", "outdx", "outdy")])

    @cached_property
    def longitudinal(self) -> PolynomialSet:
        """Outz and the fitted outdz (tracing uses outdz = sqrt(1 - outdx^2 - outdy^2))."""
        return PolynomialSet([self.outputs[name] for name in ("outz", "outdz")])

    @cached_property
    def output_plane_mm(self) -> float | None:
        """Height of the output plane above the rear vertex when outz is a constant (to 1e-9 mm), else None."""
        p = self.outputs["outz"]
        constant = p.exponents.sum(axis=1) == 0
        if np.abs(p.coefficients[~constant]).sum() > 1e-9:
            return None
        return float(p.coefficients[constant].sum())

    @property
    def degree(self) -> int:
        """Highest degree of the six."""
        return max(p.degree for p in self.outputs.values())

    def without_wrong_parity(self) -> RayPolynomials:
        """The same polynomials without terms that a rotationally symmetric lens cannot have.

        Mirror symmetry about the meridian makes outx and outdx odd in dx, the other outputs even.
        """
        kept = {}
        for name, p in self.outputs.items():
            keep = p.mirror_parity() == int(name in ("outx", "outdx"))
            kept[name] = OutputPolynomial(p.exponents[keep], p.coefficients[keep])
        return RayPolynomials(kept)
