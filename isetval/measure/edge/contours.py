"""Contours of an image as nearly straight segments, by gradient direction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.floating[Any]]

# Tried with half and twice the value: edges found in two charts of 40 (10 : 1 at SNR 40, 2 : 1 at 20), a real frame (16)
SMOOTH_PX = 1.2  # half of it finds 42 in the chart at 2 : 1 (pieces) and 18 in the real frame, twice of it 40 and 17
THRESHOLD_SIGMA = 5.0  # of the gradient's noise: one false pixel in 3e5 (Rayleigh, exp(-12.5)); half of it finds the same edges
SECTORS = 16  # of 22.5 degrees, overlapping by as much; 8 find 12 in the real frame, 32 find 14
COARSE_PX = 5.0  # wide enough that its direction shares 4 % of a fine gradient's noise, narrow enough to follow a bent edge
MIN_SEEN_PX = 9.0  # a third of the shortest edge that is taken, in cells of 2 px; half and twice find the same


@dataclass(frozen=True)
class Segment:
    """A nearly straight contour, in pixels of the image it was found in.

    ``normal_deg`` points from dark to bright (0: larger columns, 90: larger rows); ``bend_px`` is the
    bow over the length, signed along the normal; ``width_px`` the edge's rough standard deviation.
    """

    row_px: float
    col_px: float
    normal_deg: float
    length_px: float
    bend_px: float
    width_px: float
    step: float
    noise: float
    margin_px: float = 3.0

    def bow(self, along: Float) -> Float:
        """Offset of the contour from its chord's middle line along the normal at ``along``."""
        t = along / (0.5 * self.length_px)
        return np.asarray(self.signed_bend * (1 / 3 - t**2))

    @property
    def signed_bend(self) -> float:
        """Bow with its sign."""
        return self._sign * self.bend_px

    _sign: float = 1.0

    def part(self, place: float, share: float) -> Segment:
        """A piece of ``share`` of the length, ``place`` (of the length) from the middle."""
        radians = np.radians(self.normal_deg)
        shift = place * self.length_px
        offset = float(self.bow(np.array([shift]))[0])
        turn = float(np.degrees(np.arctan(-2 * self.signed_bend * shift / (0.5 * self.length_px) ** 2)))
        row = self.row_px + np.cos(radians) * shift + np.sin(radians) * offset
        col = self.col_px - np.sin(radians) * shift + np.cos(radians) * offset
        return replace(
            self,
            row_px=float(row),
            col_px=float(col),
            length_px=self.length_px * share,
            bend_px=self.bend_px * share**2,
            normal_deg=float((self.normal_deg - turn) % 360),
            margin_px=1.0,
        )

    def scaled(self, scale: float) -> Segment:
        """The segment in capture pixels, ``scale`` of them per image pixel (their first centres half a cell apart)."""
        shift = (scale - 1) / 2
        return replace(
            self,
            row_px=self.row_px * scale + shift,
            col_px=self.col_px * scale + shift,
            length_px=self.length_px * scale,
            bend_px=self.bend_px * scale,
            width_px=self.width_px * scale,
            margin_px=self.margin_px * scale,
        )


def find_segments(image: Float) -> list[Segment]:
    """All contours longer than a few pixels, longest first."""
    from scipy import ndimage

    smooth = ndimage.gaussian_filter(image, SMOOTH_PX)
    down = ndimage.sobel(smooth, axis=0) / 8
    right = ndimage.sobel(smooth, axis=1) / 8
    size = np.hypot(down, right)
    noise = gradient_noise(smooth, down, right)
    strong = size > THRESHOLD_SIGMA * noise
    ridge = strong & _is_ridge(size, down, right)
    direction = np.degrees(np.arctan2(down, right)) % 360
    pixels = np.flatnonzero(ridge)
    return _grow(pixels, image.shape, size, direction, noise)


def gradient_noise(smooth: Float, down: Float, right: Float) -> Float:
    """Standard deviation of a gradient component at the level of every pixel, from its spread at equal levels."""
    flat, level = np.abs(_along_contours(smooth, down, right)).ravel(), smooth[::2, ::2].ravel()
    edges = np.quantile(level, np.linspace(0, 1, 9))
    number = np.clip(np.searchsorted(edges, level, side="right") - 1, 0, 7)
    spread, center = [], []
    for k in range(8):
        part = flat[number == k]
        if part.size > 50:
            # the lower quartile: half of the pixels of a level may lie on corners and texture
            spread.append(float(np.quantile(part, 0.25)) / 0.3186)
            center.append(float(np.median(level[number == k])))
    floor = 1e-3 * float(np.quantile(smooth, 0.99) - np.quantile(smooth, 0.01)) + 0.03
    if not spread:
        return np.full(smooth.shape, floor)
    order = np.argsort(center)
    out = np.interp(smooth, np.array(center)[order], np.array(spread)[order])
    return np.asarray(np.maximum(out, floor))


def _along_contours(smooth: Float, down: Float, right: Float) -> Float:
    """Gradient along the contours, at every second pixel: noise alone, also at the levels that only an edge's slope passes.

    A component along a fixed axis holds the slope of every edge across that axis.  In white noise the coarse direction
    is that of a gradient correlated by rho with the fine one, so that sqrt(1 - rho^2) of the noise is left to be seen.
    """
    from scipy import ndimage

    coarse = ndimage.gaussian_filter(smooth, COARSE_PX)
    some = (slice(None, None, 2), slice(None, None, 2))
    turn = np.arctan2(ndimage.sobel(coarse, axis=0)[some], ndimage.sobel(coarse, axis=1)[some])
    wide = np.hypot(COARSE_PX, SMOOTH_PX)
    rho = (2 * SMOOTH_PX * wide / (SMOOTH_PX**2 + wide**2)) ** 2
    return np.asarray((down[some] * np.cos(turn) - right[some] * np.sin(turn)) / np.sqrt(1 - rho**2))


def _is_ridge(size: Float, down: Float, right: Float) -> NDArray[np.bool_]:
    """Pixels whose gradient is the largest across the contour (along the nearer axis of the gradient)."""
    vertical = np.abs(right) >= np.abs(down)
    out = np.zeros(size.shape, dtype=bool)
    core = (slice(1, -1), slice(1, -1))
    left_right = (size[1:-1, 1:-1] >= size[1:-1, :-2]) & (size[1:-1, 1:-1] > size[1:-1, 2:])
    up_down = (size[1:-1, 1:-1] >= size[:-2, 1:-1]) & (size[1:-1, 1:-1] > size[2:, 1:-1])
    out[core] = np.where(vertical[core], left_right, up_down)
    return out


def _grow(pixels: NDArray[np.intp], shape: tuple[int, ...], size: Float, direction: Float, noise: Float) -> list[Segment]:
    """Connected ridge pixels of similar direction, in overlapping sectors; the longest wins its pixels."""
    from scipy import ndimage

    angle = direction.ravel()[pixels]
    found: list[tuple[int, NDArray[np.intp]]] = []
    mask = np.zeros(shape, dtype=bool)
    width = 360 / SECTORS
    for k in range(SECTORS):
        chosen = pixels[np.abs((angle - k * width + 180) % 360 - 180) <= width]
        if len(chosen) < MIN_SEEN_PX:
            continue
        mask[...] = False
        mask.ravel()[chosen] = True
        labels, _ = ndimage.label(mask, structure=np.ones((3, 3)))
        name = labels.ravel()[chosen]
        order = np.argsort(name, kind="stable")
        cuts = np.flatnonzero(np.diff(name[order])) + 1
        found += [(len(part), part) for part in np.split(chosen[order], cuts) if len(part) >= MIN_SEEN_PX]
    found.sort(key=lambda item: -item[0])
    taken = np.zeros(shape, dtype=bool).ravel()
    out = []
    for number, part in found:
        if taken[part].sum() > 0.4 * number:
            continue
        taken[part] = True
        segment = _segment(part, shape, size, direction, noise)
        if segment is not None:
            out.append(segment)
    return out


def _segment(part: NDArray[np.intp], shape: tuple[int, ...], size: Float, direction: Float, noise: Float) -> Segment | None:
    """Parabola through the ridge pixels, in the frame of their mean direction."""
    row, col = (v.astype(float) for v in np.unravel_index(part, shape))
    turn = np.radians(direction.ravel()[part])
    radians = float(np.arctan2(np.sin(turn).mean(), np.cos(turn).mean()))
    for _ in range(2):
        normal, tangent = (np.sin(radians), np.cos(radians)), (np.cos(radians), -np.sin(radians))
        along = row * tangent[0] + col * tangent[1]
        across = row * normal[0] + col * normal[1]
        middle = (along.min() + along.max()) / 2
        half = max((along.max() - along.min()) / 2, 1.0)
        t = (along - middle) / half
        inner = np.abs(t) < 0.95
        c = np.polynomial.polynomial.polyfit(t[inner], across[inner], 2)
        radians -= float(np.arctan(c[1] / half))
    rest = across - np.polynomial.polynomial.polyval(t, c)
    if float(np.median(np.abs(rest))) > 1.0 or 2 * half < MIN_SEEN_PX or len(np.unique(np.rint(along))) < 0.5 * 2 * half:
        return None
    # the polynomial is a0 + a2 t^2: its mean over the chord is at a0 + a2/3
    center = c[0] + c[2] / 3
    row0 = middle * np.cos(radians) + center * np.sin(radians)
    col0 = -middle * np.sin(radians) + center * np.cos(radians)
    peak = float(np.median(size.ravel()[part]))
    return Segment(
        row_px=float(row0),
        col_px=float(col0),
        normal_deg=float(np.degrees(radians) % 360),
        length_px=2 * half,
        bend_px=float(abs(c[2])),
        width_px=1.5,
        step=peak,
        noise=float(np.median(noise.ravel()[part])),
        _sign=float(-np.sign(c[2]) or 1.0),
    )
