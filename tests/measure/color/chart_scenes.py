"""A plain numpy picture of a 24-patch chart on a raw mosaic, with noise: the truth of these tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isetval.core.capture import Capture

# Lab (D50) of the classic chart, patches 1..24 (published averages of the maker's charts before November 2014)
LAB = np.array(
    [
        [37.986, 13.555, 14.059], [65.711, 18.13, 17.81], [49.927, -4.88, -21.925], [43.139, -13.095, 21.905],
        [55.112, 8.844, -25.399], [70.719, -33.397, -0.199], [62.661, 36.067, 57.096], [40.02, 10.41, -45.964],
        [51.124, 48.239, 16.248], [30.325, 22.976, -21.587], [72.532, -23.709, 57.255], [71.941, 19.363, 67.857],
        [28.778, 14.179, -50.297], [55.261, -38.342, 31.37], [42.101, 53.378, 28.19], [81.733, 4.039, 79.819],
        [51.935, 49.986, -14.574], [51.038, -28.631, -28.638], [96.539, -0.425, 1.186], [81.257, -0.638, -0.335],
        [66.766, -0.734, -0.504], [50.867, -0.153, -0.27], [35.656, -0.421, -1.231], [20.461, -0.079, -0.973],
    ]
)  # fmt: skip


def chart_xyz() -> np.ndarray:
    """(24, 3) XYZ under D50, white Y = 1, from Lab by CIE 15."""
    fy = (LAB[:, 0] + 16) / 116
    f = np.stack([fy + LAB[:, 1] / 500, fy, fy - LAB[:, 2] / 200], axis=1)
    xyz = np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29))
    return xyz * np.array([0.9642, 1.0, 0.8251])


# a made-up camera: XYZ to raw R, G, B, unbalanced as raw data are
CAMERA = np.array([[0.55, 0.15, -0.02], [-0.15, 1.10, 0.10], [0.02, -0.10, 0.60]])


def camera_rgb() -> np.ndarray:
    """(24, 3) raw responses, white green about 1."""
    return np.maximum(chart_xyz() @ CAMERA.T, 1e-3)


@dataclass(frozen=True)
class ChartScene:
    """Chart geometry in pixels: patch pitch, gap between patches, place and turn; a dark frame round it."""

    rows: int = 900
    cols: int = 1200
    pitch_px: float = 110.0
    gap: float = 0.15
    frame: float = 0.25
    center: tuple[float, float] = (450.0, 600.0)
    turn_deg: float = 0.0
    mirrored: bool = False
    perspective: float = 0.0
    level_e: float = 4000.0
    gain_dn_per_e: float = 0.17
    read_e: float = 3.0
    background: float = 0.25
    cfa: str = "RGGB"
    black_dn: float = 64.0
    white_dn: float = 1023.0

    def to_chart(self, row, col):
        """Chart coordinates (down, along) in pitches, (0, 0) at the middle of patch 1."""
        angle = np.radians(self.turn_deg)
        y, x = row - self.center[0], col - self.center[1]
        along = (np.cos(angle) * x + np.sin(angle) * y) / self.pitch_px
        down = (-np.sin(angle) * x + np.cos(angle) * y) / self.pitch_px
        scale = 1 + self.perspective * along
        along, down = along / scale, down / scale
        along = -along if self.mirrored else along
        return down + 1.5, along + 2.5

    def to_pixel(self, down, along):
        """Inverse of ``to_chart``."""
        u, v = along - 2.5, down - 1.5
        u = -u if self.mirrored else u
        scale = 1 / (1 - self.perspective * u)
        u, v = u * scale, v * scale
        angle = np.radians(self.turn_deg)
        x, y = (np.cos(angle) * u - np.sin(angle) * v), (np.sin(angle) * u + np.cos(angle) * v)
        return self.center[0] + y * self.pitch_px, self.center[1] + x * self.pitch_px

    def linear(self) -> np.ndarray:
        """(rows, cols, 3) raw responses without noise."""
        row, col = np.mgrid[: self.rows, : self.cols].astype(float)
        down, along = self.to_chart(row, col)
        i, j = np.rint(down).astype(int), np.rint(along).astype(int)
        on_grid = (i >= 0) & (i < 4) & (j >= 0) & (j < 6)
        half = (1 - self.gap) / 2
        inside = on_grid & (np.abs(down - i) <= half) & (np.abs(along - j) <= half)
        edge = 0.5 + self.frame
        board = (down > -edge) & (down < 3 + edge) & (along > -edge) & (along < 5 + edge)
        out = np.full((self.rows, self.cols, 3), self.background) * np.array([0.66, 1.05, 0.5])
        out[board] = 0.03 * np.array([0.66, 1.05, 0.5])
        number = np.clip(i, 0, 3) * 6 + np.clip(j, 0, 5)
        out[inside] = camera_rgb()[number[inside]]
        return out

    def capture(self, rng, *, shading=None) -> Capture:
        """A raw frame; ``shading`` multiplies the light pixel by pixel."""
        rgb = self.linear() * self.level_e
        if shading is not None:
            rgb = rgb * shading[..., None]
        index = np.array(["RGB".index(c) for c in self.cfa]).reshape(2, 2)
        which = np.tile(index, (self.rows // 2 + 1, self.cols // 2 + 1))[: self.rows, : self.cols]
        electrons = np.take_along_axis(rgb, which[..., None], axis=2)[..., 0]
        noisy = rng.poisson(electrons) + self.read_e * rng.standard_normal(electrons.shape)
        dn = np.clip(np.rint(noisy * self.gain_dn_per_e + self.black_dn), 0, self.white_dn).astype(np.uint16)
        return Capture.from_array(dn, cfa=self.cfa, black_dn=self.black_dn, white_dn=self.white_dn)

    def truth_dn(self) -> np.ndarray:
        """(24, 3) mean DN above black."""
        return camera_rgb() * self.level_e * self.gain_dn_per_e
