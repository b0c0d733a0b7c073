"""One rung of the error ladder."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LadderRow:
    """How well a model predicts a metric family.

    ``role`` is *calibration* where an effect of the model was fitted to these captures, else
    *prediction*; ``mean_square_z`` is 1 for a true model; ``rms_relative_error`` is the rms residual
    over the rms measured value.
    """

    model: str
    family: str
    role: str
    n: int
    mean_square_z: float
    rms_relative_error: float
