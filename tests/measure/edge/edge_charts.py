"""A chart of slanted squares with bar codes and text, edges blurred by a Gaussian."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from isetval.core.capture import Capture

SIGMA_PX = 0.7
TRUE_MTF50 = float(np.sqrt(np.log(2) / 2) / np.pi / SIGMA_PX)


class Chart:
    """White ground, dark squares; ``edges`` holds (row, col) of the middle of every slanted edge."""

    def __init__(self, rows: int, cols: int, *, contrast: float = 10.0, seed: int = 0) -> None:
        self.picture = np.ones((rows, cols))
        self.dark = 1 / contrast
        self.edges: list[tuple[float, float]] = []
        self.rng = np.random.default_rng(seed)

    def rectangle(self, row: float, col: float, width: float, height: float, angle_deg: float) -> None:
        rows, cols = self.picture.shape
        reach = int(max(width, height) * 0.75 + 12)
        r0, r1 = max(0, int(row) - reach), min(rows, int(row) + reach)
        c0, c1 = max(0, int(col) - reach), min(cols, int(col) + reach)
        y, x = np.mgrid[r0:r1, c0:c1].astype(float)
        angle = np.deg2rad(angle_deg)
        u = (x - col) * np.cos(angle) + (y - row) * np.sin(angle)
        v = -(x - col) * np.sin(angle) + (y - row) * np.cos(angle)
        cover = (ndtr((u + width / 2) / SIGMA_PX) - ndtr((u - width / 2) / SIGMA_PX)) * (
            ndtr((v + height / 2) / SIGMA_PX) - ndtr((v - height / 2) / SIGMA_PX)
        )
        part = self.picture[r0:r1, c0:c1]
        part += (self.dark - part) * cover

    def square(self, row: float, col: float, side: float, angle_deg: float) -> None:
        self.rectangle(row, col, side, side, angle_deg)
        for quarter in range(4):
            turn = np.deg2rad(angle_deg + 90 * quarter)
            self.edges.append((row + side / 2 * np.sin(turn), col + side / 2 * np.cos(turn)))

    def bar_code(self, row: float, col: float) -> None:
        place = col - 60.0
        while place < col + 60:
            width = self.rng.choice([4, 8, 12])
            self.rectangle(row + (place - col) * 0.09, place + width / 2, width, 90, 5)
            place += width + self.rng.choice([4, 8, 12])

    def text(self, row: float, col: float) -> None:
        for line in range(-50, 51, 25):
            for letter in range(-60, 61, 18):
                for _ in range(3):
                    shift = self.rng.uniform(-6, 6)
                    if self.rng.random() < 0.5:
                        self.rectangle(row + line + shift, col + letter, 12, 3, 5)
                    else:
                        self.rectangle(row + line, col + letter + shift, 3, 16, 5)

    def capture(self, *, snr: float | None = None, cfa: str = "MONO", bright_dn: float = 12000.0) -> Capture:
        level = self.picture * bright_dn
        if snr is not None:
            gain = bright_dn / snr**2
            level = self.rng.poisson(level / gain) * gain
        return Capture.from_array(np.clip(np.rint(level + 256), 0, 16383), cfa=cfa, black_dn=256, white_dn=16383)


def chart(rows=600, cols=800, *, pitch=200, side=110.0, contrast=10.0, extras=True, seed=0) -> Chart:
    out = Chart(rows, cols, contrast=contrast, seed=seed)
    number = 0
    for row in range(pitch // 2, rows - pitch // 2 + 1, pitch):
        for col in range(pitch // 2, cols - pitch // 2 + 1, pitch):
            number += 1
            if extras and number % 5 == 0:
                (out.bar_code if number % 2 else out.text)(row, col)
                continue
            angle = out.rng.uniform(2, 43) * out.rng.choice([1, -1])
            out.square(row + out.rng.uniform(-3, 3), col + out.rng.uniform(-3, 3), side, angle)
    return out
