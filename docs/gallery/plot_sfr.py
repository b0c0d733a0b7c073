"""
Slanted edge: default and ISO 12233
===================================

One edge of known blur, measured by the default and by ISO 12233:2023, beside its closed-form MTF.
"""

import numpy as np
from matplotlib import pyplot as plt

import isetval
from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture

truth = EdgeTruth(EdgeBlur(gaussian_sigma_px=0.7), angle_deg=5.0)
capture = edge_capture(truth, shape=(128, 128))
results = {name: isetval.measure.sfr(capture, method=name) for name in ("default", "iso12233:2023")}
figure, axes = plt.subplots(figsize=(6.5, 4.2), layout="constrained")
isetval.plots.plot_sfr(results, axes)
frequency = np.linspace(0, 1, 101)
axes.plot(frequency, truth.mtf(frequency), "k--", lw=1, label="closed form")
_ = axes.legend()
