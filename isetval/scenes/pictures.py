"""Sharp pictures behind a lens: a picture of few spectra, blurred exactly as its transfer function says."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.signal import Transfer

Float = NDArray[np.float64]
HALO_PX = 96
EDGE_NODE_NM = 50.0
PICTURE_NODE_NM = 120.0
TOLERANCE = 1e-4
KEEP = 12
_BLURRED: OrderedDict[bytes, Float] = OrderedDict()
_LABELLED: OrderedDict[bytes, SpectralPicture] = OrderedDict()


def _keep(cache: OrderedDict[bytes, Any], key: bytes, value: Any) -> None:
    """Enter a value; the oldest leaves."""
    while len(cache) >= KEEP:
        cache.popitem(last=False)
    cache[key] = value


def wavelength_nodes(wavelength_nm: Float, *, apart_nm: float = EDGE_NODE_NM) -> tuple[Float, Float]:
    """Nodes at most ``apart_nm`` apart and the weights (nodes, bands) of linear interpolation between them.

    A diffraction transfer function depends on wavelength times frequency and bends little: at half a
    cycle per pixel of a F/1.7 lens the interpolation is good to 2e-4 of the step.
    """
    count = max(2, int(np.ceil(np.ptp(wavelength_nm) / apart_nm)) + 1) if wavelength_nm.size > 1 else 1
    nodes = np.linspace(wavelength_nm[0], wavelength_nm[-1], count)
    return nodes, np.array([np.interp(wavelength_nm, nodes, unit) for unit in np.eye(count)])


@dataclass(frozen=True, eq=False)
class SpectralPicture:
    """A relative picture (bands, rows, cols) with a halo, given by few spatial parts.

    ``spectra`` is (bands, parts) and ``parts`` (parts, rows + 2 halo, cols + 2 halo): the picture is
    their product.  Blur is a product in the Fourier domain; the transfer function is sampled at nodes
    `PICTURE_NODE_NM` apart and interpolated linearly in between: inside a patch blur is a tail of a
    percent, of which the interpolation leaves less than a hundredth.  The last pictures are kept, by
    their content and by samples of the transfer function: effects that do not blur cost nothing.
    """

    spectra: Float
    parts: Float
    halo: int

    @classmethod
    def of(cls, picture: Float, halo: int) -> SpectralPicture:
        """A picture (bands, rows + 2 halo, cols + 2 halo) by its singular vectors."""
        bands = len(picture)
        u, s, vt = np.linalg.svd(picture.reshape(bands, -1), full_matrices=False)
        rank = max(1, int(np.sum(s > TOLERANCE * s[0])))
        return cls(u[:, :rank] * s[:rank], vt[:rank].reshape(rank, *picture.shape[1:]), halo)

    @classmethod
    def of_labels(cls, label: NDArray[np.intp], spectra: Float, halo: int) -> SpectralPicture:
        """A picture of uniform regions: ``label`` (rows, cols) picks a column of ``spectra`` (bands, labels)."""
        key = hashlib.sha256(repr((label.shape, spectra.shape, halo)).encode() + label.tobytes() + spectra.tobytes()).digest()
        if key not in _LABELLED:
            u, s, vt = np.linalg.svd(spectra, full_matrices=False)
            rank = max(1, int(np.sum(s > TOLERANCE * s[0])))
            _keep(_LABELLED, key, cls(u[:, :rank] * s[:rank], vt[:rank][:, label], halo))
        return _LABELLED[key]

    @cached_property
    def digest(self) -> bytes:
        """Of the parts: computed once, they are tens of megabytes."""
        return hashlib.sha256(self.parts.tobytes()).digest()

    def sample(self, amplitude: Float, transfer: Transfer | None, wavelength_nm: Float | None) -> Float:
        """The blurred picture times ``amplitude``, (bands, rows, cols)."""
        inside = slice(self.halo, -self.halo or None)
        if transfer is None or wavelength_nm is None:
            parts = self.parts[:, inside, inside]
            return np.asarray(amplitude * np.tensordot(self.spectra, parts, axes=(1, 0)))
        nodes, weights = wavelength_nodes(wavelength_nm, apart_nm=PICTURE_NODE_NM)
        blurred = self._remembered(transfer, nodes, inside)
        mix = (weights.T[:, :, None] * self.spectra[:, None, :]).reshape(wavelength_nm.size, -1)
        rows, cols = blurred.shape[-2:]
        return np.asarray(amplitude * (mix @ blurred.reshape(mix.shape[1], -1)).reshape(-1, rows, cols))

    def _remembered(self, transfer: Transfer, nodes: Float, inside: slice) -> Float:
        probe = np.linspace(-0.5, 0.5, 23)
        samples = [np.asarray(transfer(probe[:, None], probe[None, ::2], np.array(node))) for node in nodes[[0, -1]]]
        digest = hashlib.sha256(self.digest)
        for sample in samples:
            digest.update(np.round(np.asarray(sample, complex), 12).tobytes())
        key = digest.digest()
        if key not in _BLURRED:
            _keep(_BLURRED, key, self._blurred(transfer, nodes, inside))
        _BLURRED.move_to_end(key)
        return _BLURRED[key]

    def _blurred(self, transfer: Transfer, nodes: Float, inside: slice) -> Float:
        """Parts at the nodes, (nodes, parts, rows, cols)."""
        from scipy import fft

        shape = tuple(fft.next_fast_len(n, real=True) for n in self.parts.shape[1:])
        padded = np.pad(
            self.parts, [(0, 0), *((0, n - m) for n, m in zip(shape, self.parts.shape[1:], strict=True))], mode="edge"
        )
        spectrum = fft.rfft2(padded)
        fy: Float = np.asarray(np.fft.fftfreq(shape[0]))[:, None]
        fx: Float = np.asarray(np.fft.rfftfreq(shape[1]))[None, :]
        out: list[Any] = []
        for node in nodes:
            otf = np.asarray(transfer(fx, fy, np.array(node)))
            picture = fft.irfft2(spectrum * otf, shape)
            rows, cols = self.parts.shape[1:]
            out.append(picture[:, :rows, :cols][:, inside, inside])
        return np.array(out)
