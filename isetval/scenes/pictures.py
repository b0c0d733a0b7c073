"""Sharp pictures behind a lens: a picture of few spectra, blurred exactly as its transfer function says."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.cache import content_hash
from isetval.core.signal import Transfer

Float = NDArray[np.float64]
HALO_PX = 96
EDGE_NODE_NM = 50.0
STEP_TOLERANCE = 2e-4
"""Largest error of a blurred step, as a share of it, from taking a transfer function at few wavelengths."""
PROBED = (
    0.6  # share of it that twelve frequencies along four directions may show: a step crossed by a line errs by 1.4 times that
)
TRANSFER_COST = 4  # of a transfer function on a picture's frequencies, in pictures: 10 to 40 ms against 2.6 on 320 x 384
FEW = 7  # nodes of one polynomial; two of four each take no more
COUNTS = (1, 2, 3, 4, 5, 7, 9, 13, 17, 25)
TOLERANCE = 1e-6
"""Of the largest part of a picture of labels, what is left out.  Errors are of the brightest spectra, and a dark colour under a
lamp with lines has some thousandth of those in a channel: at 1e-4 it was off by more than a chart's means are known to."""
BLOCK = 1 << 14  # numbers of each part at a time: 5 MB of forty parts, and no copy of all in twice the precision
KEEP_BYTES = 300_000_000  # of each kind, in each process: five windows of a rendered chart
_BLURRED: OrderedDict[str, Float] = OrderedDict()
_LABELLED: OrderedDict[str, SpectralPicture] = OrderedDict()
_TRANSFORMS: OrderedDict[str, Float] = OrderedDict()
_MIXED: OrderedDict[str, Float] = OrderedDict()
_OPTICS: OrderedDict[str, Any] = OrderedDict()
# frequencies at which a transfer function is looked at, in cycles per sample: along both axes and both diagonals
_PROBE: Float = np.linspace(1 / 24, 0.5, 12)
PROBE_X: Float = np.concatenate([_PROBE, 0 * _PROBE, _PROBE, -_PROBE])
PROBE_Y: Float = np.concatenate([0 * _PROBE, _PROBE, _PROBE, _PROBE])
DIRECTIONS = 4


def keep(cache: OrderedDict[str, Any], key: str, value: Any) -> None:
    """Enter a value with ``nbytes``; the oldest leave while all together are too large."""
    cache[key] = value
    while len(cache) > 1 and sum(one.nbytes for one in cache.values()) > KEEP_BYTES:
        cache.popitem(last=False)


def wavelength_nodes(wavelength_nm: Float, *, apart_nm: float = EDGE_NODE_NM) -> tuple[Float, Float]:
    """Nodes at most ``apart_nm`` apart and the weights (nodes, bands) of linear interpolation between them.

    A diffraction transfer function depends on wavelength times frequency and bends little: at half a
    cycle per pixel of a F/1.7 lens the interpolation is good to 2e-4 of the step.
    """
    count = max(2, int(np.ceil(np.ptp(wavelength_nm) / apart_nm)) + 1) if wavelength_nm.size > 1 else 1
    nodes = np.linspace(wavelength_nm[0], wavelength_nm[-1], count)
    return nodes, np.array([np.interp(wavelength_nm, nodes, unit) for unit in np.eye(count)])


def transfer_nodes(probe: Float, wavelength_nm: Float) -> tuple[Float, Float]:
    """Nodes of a transfer function in wavelength and the weights (nodes, bands) of the polynomial through them.

    Chebyshev's extrema between the ends of the grid, as many as it takes for `STEP_TOLERANCE` at every band; at worst the
    bands themselves.  Where many are needed the grid is parted at its sharpest bend if that takes fewer: errors of colour are
    stated for red and blue and have a corner at green, at which no polynomial goes round.

    ``probe`` (frequencies, bands) holds values on the rising grid at `PROBE_X`, `PROBE_Y`: a step has the
    spectrum 1/(2 pi i f), so that errors d(f) along a direction leave less than the sum of |d(f)| df/(pi f) of it.
    """
    found = _through_few(probe, wavelength_nm)
    if len(found[0]) <= FEW:
        return found
    bend = 1 + int(np.argmax(np.abs(np.diff(probe, 2, axis=1)).max(axis=0)))
    left, right = (transfer_nodes(probe[:, part], wavelength_nm[part]) for part in (slice(bend + 1), slice(bend, None)))
    if len(left[0]) + len(right[0]) >= len(found[0]):
        return found
    weights = np.zeros((len(left[0]) + len(right[0]), wavelength_nm.size))
    weights[: len(left[0]), : bend + 1] = left[1]
    weights[len(left[0]) :, bend + 1 :] = right[1][:, 1:]
    return np.concatenate([left[0], right[0]]), weights


def _through_few(probe: Float, wavelength_nm: Float) -> tuple[Float, Float]:
    """`transfer_nodes` of one polynomial for all bands."""
    for count in COUNTS:
        if count >= wavelength_nm.size:
            break
        places, weights = _polynomial(wavelength_nm.tobytes(), count)
        off = np.abs(probe[:, places] @ weights - probe).reshape(DIRECTIONS, _PROBE.size, -1)
        if np.tensordot(off, 1 / (np.pi * np.arange(1, _PROBE.size + 1)), (1, 0)).max() <= PROBED * STEP_TOLERANCE:
            return wavelength_nm[places], weights
    return wavelength_nm, np.eye(wavelength_nm.size)


@lru_cache(maxsize=256)
def _polynomial(wavelength_nm: bytes, count: int) -> tuple[NDArray[np.intp], Float]:
    """Places of at most ``count`` nodes on a grid, given by its bytes, and the weights (nodes, bands) of the polynomial there."""
    grid = np.frombuffer(wavelength_nm)
    low, high = grid[[0, -1]]
    unit = np.zeros(1) if low == high else (2 * grid - low - high) / (high - low)
    index = np.unique(np.searchsorted(unit, -np.cos(np.pi * np.arange(count) / max(1, count - 1)) - 1e-9))
    at = unit[index] if count > 1 else unit[[unit.size // 2]]
    powers = np.polynomial.chebyshev.chebvander
    weights = np.linalg.solve(powers(at, at.size - 1).T, powers(unit, at.size - 1).T)
    weights.setflags(write=False)
    return np.searchsorted(unit, at), weights


@dataclass(frozen=True, eq=False)
class SpectralPicture:
    """A relative picture (bands, rows, cols) with a halo, given by few spatial parts.

    ``spectra`` is (bands, parts) and ``parts`` (parts, rows, cols), ``subsample`` times finer than the pixels and with a
    margin of ``halo`` pixels: the picture is their product.  ``averaged`` says that a sample is the mean over its cell and
    not the value at its middle.  Blur is a product in the Fourier domain; the transfer function is taken at the few
    wavelengths of `transfer_nodes` within the band of each part.  ``made_from`` is the digest of what it was made from, where
    that is known.  The last pictures are kept, by their content and by
    samples of the transfer function: effects that do not blur cost nothing.
    """

    spectra: Float
    parts: NDArray[np.floating[Any]]
    halo: int
    subsample: int = 1
    averaged: bool = False
    made_from: str = ""

    @classmethod
    def of_labels(cls, label: NDArray[np.intp], spectra: Float, halo: int) -> SpectralPicture:
        """A picture of uniform regions: ``label`` (rows, cols) picks a column of ``spectra`` (bands, labels)."""
        key = content_hash((label, spectra, halo))
        if key not in _LABELLED:
            u, s, vt = np.linalg.svd(spectra, full_matrices=False)
            rank = max(1, int(np.sum(s > TOLERANCE * s[0])))
            keep(_LABELLED, key, cls(u[:, :rank] * s[:rank], vt[:rank][:, label], halo, made_from=key))
        _LABELLED.move_to_end(key)
        return _LABELLED[key]

    @property
    def nbytes(self) -> int:
        """Of the parts."""
        return self.parts.nbytes

    @cached_property
    def digest(self) -> str:
        """Of what it was made from, or of the parts: computed once, they are tens of megabytes."""
        return self.made_from or content_hash((self.parts, self.halo, self.subsample, self.averaged))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns in pixels, without the margin."""
        rows, cols = (n // self.subsample - 2 * self.halo for n in self.parts.shape[1:])
        return rows, cols

    def sample(self, amplitude: Float, transfer: Transfer | None, wavelength_nm: Float | None) -> Float:
        """The blurred picture times ``amplitude``, (bands, rows, cols); without a transfer function, the mean over each pixel."""
        mix, parts = self._seen(transfer, wavelength_nm)
        return np.asarray(amplitude * (mix @ parts.reshape(len(parts), -1)).reshape(-1, *self.shape))

    def mixed(self, weights: Float, transfer: Transfer | None, wavelength_nm: Float | None) -> Float:
        """Sums of the blurred picture over the bands, with ``weights`` (channels, bands): (channels, rows, cols).

        Behind a transfer function the sums are taken before they are transformed back: a channel is one picture where the parts
        at their nodes are forty.  The last ones are kept, whatever the light's level.
        """
        if transfer is not None and wavelength_nm is not None:
            transfer = self._of_samples(transfer)
            level = float(np.abs(weights).max()) or 1.0
            relative = np.round(weights / level, 12)
            shares, wanted, nodes, optics = self._wanted(transfer, wavelength_nm)
            key = content_hash((self.digest, optics, wanted, nodes, relative))
            if key not in _MIXED:
                keep(_MIXED, key, self._summed(transfer, optics, relative @ shares, wanted, nodes))
            _MIXED.move_to_end(key)
            return level * _MIXED[key]
        mix, parts = self._seen(transfer, wavelength_nm)
        return np.asarray(((weights @ mix) @ parts.reshape(len(parts), -1)).reshape(-1, *self.shape))

    def _seen(self, transfer: Transfer | None, wavelength_nm: Float | None) -> tuple[Float, Float]:
        """Few pictures (pictures, rows, cols) and the spectra (bands, pictures) that mix them."""
        if transfer is None or wavelength_nm is None:
            return self.spectra, self._binned()
        return self._blurred(self._of_samples(transfer), wavelength_nm)

    def _of_samples(self, transfer: Transfer) -> Transfer:
        """The transfer function as the samples see it: those of labels are whole pixels of one colour."""
        of_samples: Transfer = getattr(transfer, "of_samples", transfer)
        return transfer if self.averaged or self.subsample > 1 else of_samples

    def _probe(self, transfer: Transfer, wavelength_nm: Float) -> Float:
        """Samples (frequencies, bands) of a transfer function, by which it is known."""
        s = self.subsample
        probe = np.asarray(transfer(PROBE_X[None, :] * s, PROBE_Y[None, :] * s, wavelength_nm[:, None]))
        return np.asarray(np.broadcast_to(probe, (wavelength_nm.size, PROBE_X.size)).T)

    def _nodes(self, probe: Float, wavelength_nm: Float) -> tuple[Float, Float, Float]:
        """Spectra (bands, pictures), parts (pictures, parts) and wavelengths (pictures,): each part at each of its nodes."""
        mix, parts, nodes = [], [], []
        known: dict[tuple[int, int], tuple[Float, Float]] = {}
        for part, spectrum in enumerate(self.spectra.T):
            seen = np.flatnonzero(spectrum)
            ends = (max(0, seen[0] - 1), seen[-1] + 2) if seen.size else (0, 1)
            near = slice(*ends)
            if ends not in known:
                known[ends] = transfer_nodes(probe[:, near], wavelength_nm[near])
            own, weights = known[ends]
            parts += [np.eye(len(self.parts))[part]] * own.size
            nodes += [*own]
            share = np.zeros((own.size, wavelength_nm.size))
            share[:, near] = weights * spectrum[near]
            mix.append(share)
        return np.concatenate(mix).T, np.array(parts), np.array(nodes)

    def _binned(self) -> Float:
        (rows, cols), s, edge = self.shape, self.subsample, self.halo * self.subsample
        inner = self.parts[:, edge : edge + rows * s, edge : edge + cols * s]
        return np.asarray(inner.reshape(-1, rows, s, cols, s).mean(axis=(2, 4), dtype=float))

    def _wanted(self, transfer: Transfer, wavelength_nm: Float) -> tuple[Float, Float, Float, str]:
        """Spectra (bands, pictures) that mix pictures, their parts (pictures, parts), wavelengths (pictures,); the optics."""
        probe = self._probe(transfer, wavelength_nm)
        shares, wanted, at = self._nodes(probe, wavelength_nm)
        if at.size + TRANSFER_COST * np.unique(at).size > (1 + TRANSFER_COST) * wavelength_nm.size:  # every band on its own
            shares, wanted, at = np.eye(wavelength_nm.size), self.spectra, wavelength_nm
        return shares, wanted, at, content_hash(np.round(probe.astype(complex), 12))

    def _blurred(self, transfer: Transfer, wavelength_nm: Float) -> tuple[Float, Float]:
        """Each part at each of its nodes, (pictures, rows, cols), and the spectra (bands, pictures) that mix them."""
        shares, wanted, nodes, optics = self._wanted(transfer, wavelength_nm)
        key = content_hash((self.digest, optics, wanted, nodes))
        if key not in _BLURRED:
            keep(_BLURRED, key, self._filtered(transfer, optics, wanted, nodes))
        _BLURRED.move_to_end(key)
        return shares, _BLURRED[key]

    def _summed(self, transfer: Transfer, optics: str, weights: Float, wanted: Float, nodes: Float) -> Float:
        """Sums (channels, rows, cols), with ``weights`` (channels, pictures), of what `_filtered` gives."""
        total = np.zeros((len(weights), *self._transforms.shape[1:]), complex)
        for node in np.unique(nodes):
            at = nodes == node
            total += self._together(weights[:, at] @ wanted[at]) * self._at(transfer, optics, node)
        return np.array([self._back(spectrum) for spectrum in total])

    def _together(self, shares: Float) -> Any:
        """Sums (sums, n, n / 2 + 1) of the transforms with real ``shares`` (sums, parts), block by block."""
        every = self._transforms
        flat = every.view(np.float32).reshape(len(every), -1)
        out = np.empty((len(shares), flat.shape[1]))
        for start in range(0, flat.shape[1], BLOCK):
            block = slice(start, start + BLOCK)
            np.matmul(shares, flat[:, block].astype(float), out=out[:, block])
        return out.view(complex).reshape(-1, *every.shape[1:])

    def _filtered(self, transfer: Transfer, optics: str, wanted: Float, nodes: Float) -> Float:
        """Sums of parts (pictures, parts) behind the transfer function at a wavelength each, (pictures, rows, cols)."""
        out = np.empty((len(wanted), *self.shape))
        for i, (share, node) in enumerate(zip(wanted, nodes, strict=True)):
            used = np.flatnonzero(share)
            spectrum = self._transforms[used[0]] if used.size == 1 else self._together(share[None])[0]
            out[i] = self._back(spectrum * self._at(transfer, optics, node))
        return out

    @property
    def _size(self) -> list[int]:
        """Rows and columns of the transforms."""
        from scipy import fft

        return [self.subsample * fft.next_fast_len(-(-n // self.subsample), real=True) for n in self.parts.shape[1:]]

    def _frequencies(self) -> tuple[Float, Float]:
        """Along rows (n, 1) and columns (1, n), in cycles per pixel."""
        rows, cols = self._size
        fy, fx = np.fft.fftfreq(rows, 1 / self.subsample), np.fft.rfftfreq(cols, 1 / self.subsample)
        return np.asarray(fy)[:, None], np.asarray(fx)[None, :]

    def _at(self, transfer: Transfer, optics: str, node: float) -> Any:
        """The transfer function, known by the digest of its samples, at a wavelength; charts in several lights share it."""
        key = content_hash((optics, node, self._size, self.subsample))
        if key not in _OPTICS:
            fy, fx = self._frequencies()
            keep(_OPTICS, key, np.asarray(transfer(fx, fy, np.array(node))))
        _OPTICS.move_to_end(key)
        return _OPTICS[key]

    @property
    def _transforms(self) -> Any:
        """Of the parts, (parts, n, n / 2 + 1); the last ones are kept."""
        from scipy import fft

        if self.digest not in _TRANSFORMS:
            (fy, fx), s = self._frequencies(), self.subsample
            place: Any = 1.0
            if self.averaged:  # to the pixel's middle, half a pixel less half a sample on; less what the samples' own size blurs
                place = np.exp(1j * np.pi * (1 - 1 / s) * (fx + fy)) / (np.sinc(fx / s) * np.sinc(fy / s))
            wider = [(0, n - m) for n, m in zip(self._size, self.parts.shape[1:], strict=True)]
            every = [fft.rfft2(np.pad(part.astype(float), wider, mode="edge")) * place for part in self.parts]
            keep(_TRANSFORMS, self.digest, np.array(every, np.complex64))  # 1e-7, of which pictures are kept to 1e-4
        _TRANSFORMS.move_to_end(self.digest)
        return _TRANSFORMS[self.digest]

    def _back(self, spectrum: Any) -> Float:
        """The picture (rows, cols) of a transform, without the margin."""
        from scipy import fft

        s, edge = self.subsample, self.halo * self.subsample
        seen = fft.irfft2(spectrum, self._size)
        return np.asarray(seen[edge : edge + self.shape[0] * s : s, edge : edge + self.shape[1] * s : s])
