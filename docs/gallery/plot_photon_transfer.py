"""
Photon transfer
===============

Flats of a camera with 0.5 DN/e- and 3 e- read noise; the ruler finds both.
"""

import numpy as np
from matplotlib import pyplot as plt

import isetval

rng = np.random.default_rng(3)


def frame(mean_e):
    """A flat of a mean charge."""
    dn = 64 + 0.5 * (rng.poisson(mean_e, (64, 64)) + rng.normal(0, 3, (64, 64)))
    return isetval.Capture.from_array(np.clip(np.rint(dn), 0, 1023).astype(int), time_s=max(mean_e, 1) / 1e4, bits=10)


flats = [frame(mean) for mean in (30, 100, 300, 700, 1100, 1500) for _ in range(2)]
darks = [frame(0) for _ in range(4)]
result = isetval.measure.photon_transfer(flats, dark=darks)
print(result)
figure, axes = plt.subplots(figsize=(6.5, 4.2), layout="constrained")
_ = result.plot(axes)
