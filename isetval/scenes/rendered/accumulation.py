"""Passes with independent seeds: running mean and variance per pixel, stop rule, resume, merge.

Each pass is an independent estimate of the same image.  Mean and sum of squared deviations are kept in
float64 by Welford's update (Knuth, TAOCP 2, 4.2.2; merging: Chan, Golub and LeVeque 1983), and written
after every pass, so that a killed render goes on where it was and ends with the same bits.  That holds for the scalar
variant.  The others add the samples of a pixel in float32 and in no fixed order, on all cores or a GPU: one seed gives
the same radiance to the rounding of such sums, some 1e-6 of it, and to the bit only by chance.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core import cache
from isetval.core.engine import Engine, Here, Lost, run_works
from isetval.core.errors import InputError

Float = NDArray[np.float64]
Crop = tuple[int, int, int, int]
Progress = Callable[[int, int, str], None]
DRAWS = 4


def signs(index: int) -> Float:
    """Signs (DRAWS,) of a pass in the contrasts: Walsh functions, orthogonal and balanced over every 8 passes."""
    return np.array([1.0 - 2.0 * ((index & m).bit_count() % 2) for m in range(1, DRAWS + 1)])


@dataclass(frozen=True, eq=False)
class Running:
    """Mean and sum of squared deviations of ``count`` passes, arrays of any one shape.

    ``contrasts`` (DRAWS, ...) are sums of the passes with signs, ``balance`` (DRAWS,) the sums of the signs.
    """

    count: int
    mean: Float
    squares: Float
    contrasts: NDArray[np.float32]
    balance: Float

    @classmethod
    def empty(cls, shape: tuple[int, ...]) -> Running:
        """No passes yet."""
        return cls(0, np.zeros(shape), np.zeros(shape), np.zeros((DRAWS, *shape), np.float32), np.zeros(DRAWS))

    def add(self, image: Float) -> Running:
        """With one more pass."""
        count = self.count + 1
        delta = image - self.mean
        mean = self.mean + delta / count
        sign = signs(self.count)
        contrasts = self.contrasts + (sign.reshape(-1, *[1] * image.ndim) * image).astype(np.float32)
        return Running(count, mean, self.squares + delta * (image - mean), contrasts, self.balance + sign)

    def merge(self, other: Running) -> Running:
        """With the passes of another run, made elsewhere with other seeds."""
        if self.mean.shape != other.mean.shape:
            raise InputError(
                f"passes of shape {self.mean.shape} and {other.mean.shape} cannot be merged; render the same crop and bands"
            )
        if not (self.count and other.count):
            return self if self.count else other
        count = self.count + other.count
        delta = other.mean - self.mean
        mean = self.mean + delta * (other.count / count)
        squares = self.squares + other.squares + delta**2 * (self.count * other.count / count)
        return Running(count, mean, squares, self.contrasts + other.contrasts, self.balance + other.balance)

    @property
    def variance_of_mean(self) -> Float:
        """Unbiased variance of the mean; nan for fewer than two passes."""
        if self.count < 2:
            return np.full(self.mean.shape, np.nan)
        return self.squares / (self.count * (self.count - 1))

    @property
    def draws(self) -> NDArray[np.float32]:
        """Draws (DRAWS, ...) from the distribution of the mean's error, with its covariance over pixels and bands.

        Half the difference between two halves of the passes has the variance of the mean; with signs s that sum to b, the
        contrast sum s (x - mean) over sqrt(n (n - b^2 / n)) has.  Contrasts that fewer than 8 passes do not have repeat
        the first.
        """
        out = np.zeros_like(self.contrasts)
        n = self.count
        for i, b in enumerate(self.balance):
            k = i if b * b < n * n else 0
            b = float(self.balance[k])
            if b * b < n * n:
                out[i] = (self.contrasts[k] - b * self.mean) / np.sqrt(n * (n - b * b / n))
        return out


@dataclass(frozen=True)
class NoiseTarget:
    """When to stop adding passes.

    Parameters
    ----------
    relative_sd : float, optional
        Wanted standard error of the band-mean radiance over its mean, root-mean-square over the region.
    fraction_of_shot : float, optional
        Wanted render standard deviation as a fraction of the shot noise, both in electrons.
    electrons_per_radiance : sequence of float, optional
        Electrons per unit spectral radiance for each band (needed for ``fraction_of_shot``): exposure time x
        pixel area x projected solid angle x QE x band width / photon energy.
    minimum_passes : int
        Never judged on fewer passes; the variance estimate of few passes stops too early too often.
    """

    relative_sd: float | None = None
    fraction_of_shot: float | None = None
    electrons_per_radiance: tuple[float, ...] = ()
    minimum_passes: int = 8

    def __post_init__(self) -> None:
        given = [v for v in (self.relative_sd, self.fraction_of_shot) if v is not None]
        if len(given) != 1 or not given[0] > 0:
            raise InputError("a noise target needs one of relative_sd and fraction_of_shot, above 0")
        if self.fraction_of_shot is not None and not self.electrons_per_radiance:
            raise InputError("fraction_of_shot needs electrons_per_radiance, one number for each band")

    def weights(self, bands: int) -> Float:
        """What is watched, as a weighted sum over bands, (bands,)."""
        weights = np.asarray(self.electrons_per_radiance or (1 / bands,) * bands, float)
        if weights.shape != (bands,):
            raise InputError(f"electrons_per_radiance has {weights.size} values; the render has {bands} bands")
        return weights

    def noise(self, watched: Running) -> float:
        """The noise reached, on the scale of the target."""
        variance, mean = watched.variance_of_mean, watched.mean
        if not mean.mean() > 0:
            return 0.0
        if self.fraction_of_shot is not None:
            return float(np.sqrt(variance.mean() / mean.mean()))
        return float(np.sqrt(variance.mean()) / mean.mean())

    def reached(self, watched: Running) -> bool:
        """Whether enough passes are there."""
        if watched.count < max(2, self.minimum_passes):
            return False
        return self.noise(watched) <= (self.relative_sd if self.relative_sd is not None else self.fraction_of_shot or 0.0)


@dataclass(frozen=True, eq=False)
class Render:
    """A rendered crop of the sensor's field.

    Parameters
    ----------
    radiance : float32 (bands, rows, cols)
        Spectral radiance in W/(sr m2 nm), mean over triangular bands, row 0 up and column 0 left as seen.
    variance : float32 (bands, rows, cols)
        Variance of that mean, measured from the passes, in the square of its unit.
    depth_m : float32 (rows, cols)
        Distance along the optical axis from the entrance pupil; inf where there is nothing.
    wavelength_nm : float64 (bands,)
    crop : (row0, col0, rows, cols) on the full sensor grid
    settings : mapping
        Everything needed to render it again: scene, camera, seeds, passes, variant, versions, noise reached.
    draws : float32 (draws, bands, rows, cols)
        Errors as large as the mean's own, from differences of its passes; see `Running.draws`.
    """

    radiance: NDArray[np.float32]
    variance: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    wavelength_nm: Float
    crop: Crop
    settings: Mapping[str, Any] = field(default_factory=dict)
    draws: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0, 0, 0), np.float32))

    def with_draw(self, index: int) -> Render:
        """The render with one draw of its error added."""
        return replace(self, radiance=self.radiance + self.draws[index])


@dataclass(frozen=True, eq=False)
class Irradiance:
    """Spectral irradiance on a crop of the sensor, integrated over square pixels (fill factor 1).

    Parameters
    ----------
    irradiance : float32 (bands, rows, cols)
        W/(m2 nm), mean over triangular bands and over each pixel.
    variance : float32 (bands, rows, cols)
        Variance of it from the render's noise.
    wavelength_nm : (bands,)
    crop : (row0, col0, rows, cols)
    settings : mapping
        How it was made; ``light_factor`` is the named factor on the light, 1 for the lens as its file says.
    """

    irradiance: NDArray[np.float32]
    variance: NDArray[np.float32]
    wavelength_nm: Float
    crop: Crop
    settings: Mapping[str, Any] = field(default_factory=dict)


def pass_seed(seed: int, tile: Crop, index: int) -> int:
    """32-bit seed of one pass of one tile.

    It depends on the caller's seed, the tile and the pass and on nothing else, so that a small change of the
    scene is rendered with common random numbers and differences are little noisy.  Scenes that must be
    independent of each other need different seeds.
    """
    text = f"isetval-pass-1:{seed}:{tile}:{index}"
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "little")


@dataclass(frozen=True)
class PassPlan:
    """How one tile is rendered: passes at most, samples in each, seed, stop rule."""

    tile: Crop
    passes: int
    spp_per_pass: int
    seed: int
    target: NoiseTarget | None = None


def run_passes(
    plan: PassPlan,
    draw: Callable[[int, int], Float],
    *,
    bands: int,
    folder: Path | None = None,
    progress: Callable[[int, float], None] | None = None,
    engine: Engine | None = None,
) -> tuple[Running, float]:
    """Render the passes of one tile, going on from what ``folder`` holds of them.

    Parameters
    ----------
    plan : PassPlan
    draw : callable
        ``draw(seed, spp)`` gives one pass, (bands, rows, cols).
    bands : int
    folder : Path, optional
        Folder of this tile's state; it must belong to this plan's scene and seed alone.
    progress : callable, optional
        Called with (passes done, noise reached; nan without a target).
    engine : Engine, optional
        Where passes are drawn (``draw`` can be pickled then); they are added in their order, so that the bits are the same
        (of the scalar variant, see above).

    Returns
    -------
    running : Running
        Of the bands, (bands, rows, cols).
    noise : float
        Reached, on the scale of the target; nan without one.
    """
    shape = (plan.tile[2], plan.tile[3])
    weights = plan.target.weights(bands) if plan.target else np.zeros(bands)
    image, watched = _resume(folder, (bands, *shape), plan)
    passes = _in_order(plan, draw, image.count, engine or Here())
    while image.count < plan.passes and not (plan.target and plan.target.reached(watched)):
        drawn = next(passes)
        image = image.add(drawn)
        watched = watched.add(np.tensordot(weights, drawn, 1))
        if folder is not None:
            _store(folder, image, watched)
        if progress is not None:
            progress(image.count, plan.target.noise(watched) if plan.target and image.count > 1 else float("nan"))
    return image, plan.target.noise(watched) if plan.target and image.count > 1 else float("nan")


def _in_order(plan: PassPlan, draw: Callable[[int, int], Float], first: int, engine: Engine) -> Iterator[Float]:
    """The passes from the ``first`` on; those that come early wait here, a few for each worker."""
    early: dict[int, Float] = {}
    wanted = first
    works = ([index] for index in range(first, plan.passes))
    for (index,), drawn in run_works(partial(_draw, draw, plan), works, engine, in_flight=1 if engine.workers == 1 else 0):
        if isinstance(drawn, Lost):
            raise InputError(f"pass {index + 1} of a render: {drawn.words.replace('read', 'drew')}")
        early[index] = drawn
        while wanted in early:
            yield early.pop(wanted)
            wanted += 1


def _draw(draw: Callable[[int, int], Float], plan: PassPlan, indices: Sequence[int]) -> Float:
    """One pass by its number."""
    (index,) = indices
    return draw(pass_seed(plan.seed, plan.tile, index), plan.spp_per_pass)


KINDS, PARTS = ("image", "watched"), ("mean", "squares", "contrasts", "balance")


def _fields() -> set[str]:
    return {"count", *(f"{kind}_{part}" for kind in KINDS for part in PARTS)}


def _resume(folder: Path | None, shape: tuple[int, ...], plan: PassPlan) -> tuple[Running, Running]:
    state = cache.load_arrays(folder / "passes.npz") if folder is not None else None
    if state and _fields() <= state.keys() and state["image_mean"].shape == shape and int(state["count"]) <= plan.passes:
        count = int(state["count"])
        image, watched = ([state[f"{kind}_{part}"] for part in PARTS] for kind in KINDS)
        return Running(count, *image), Running(count, *watched)
    return Running.empty(shape), Running.empty(shape[1:])


def _store(folder: Path, image: Running, watched: Running) -> None:
    state = {f"{kind}_{part}": getattr(of, part) for kind, of in zip(KINDS, (image, watched), strict=True) for part in PARTS}
    cache.save_arrays(folder / "passes.npz", state | {"count": np.array(image.count)})
