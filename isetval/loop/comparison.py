"""Where does a model fail?  Measured against predicted, with the nuisances of the laboratory refitted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign
from isetval.core.errors import InputError
from isetval.core.metric import METRIC_FIELDS
from isetval.loop.fit import Fit
from isetval.loop.ladder import CALIBRATION, PREDICTION, LadderRow, fitted_to, ladder_rows
from isetval.loop.prepared import Prepared, Say, prepare
from isetval.loop.problem import Problem
from isetval.loop.repeat_gate import repeat_gate

if TYPE_CHECKING:
    import pandas as pd

NOT_SHOWN = ("value", "sigma", "summary", "count")


@dataclass(frozen=True, eq=False)
class Comparison:
    """Measured against predicted for one or several models, and how well each family fits.

    ``table`` has one row per metric and model with measured, simulated, sigma and z (z alone, not
    whitened) and its ``basis``: *calibration* where an effect of that model was fitted to these captures, else
    *prediction*; ``ladder`` the families; ``nuisances`` the fitted unknowns of the laboratory.
    """

    table: pd.DataFrame
    ladder: tuple[LadderRow, ...]
    gate: Mapping[str, Any]
    nuisances: Mapping[str, Mapping[str, tuple[float, float]]]
    models: tuple[CameraModel, ...]
    notes: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def worst(self) -> list[LadderRow]:
        """Families of the first model, worst first."""
        own = [row for row in self.ladder if row.model == self.models[0].name and row.family != "all"]
        return sorted(own, key=lambda row: (row.mean_square_z - 1) * np.sqrt(row.n), reverse=True)

    def to_json(self) -> dict[str, Any]:
        """Everything as plain numbers and words."""
        import json

        return {
            "models": [m.name for m in self.models],
            "gate": dict(self.gate),
            "ladder": [vars(row) for row in self.ladder],
            "nuisances": {m: {k: list(v) for k, v in values.items()} for m, values in self.nuisances.items()},
            "table": json.loads(self.table.to_json(orient="records")),
            "notes": list(self.notes),
            "settings": dict(self.settings),
        }


def compare(
    model: CameraModel | Sequence[CameraModel], campaign: Campaign, *, jobs: int = 1, say: Say | None = None
) -> Comparison:
    """Compare one or several models with a measured campaign.

    Parameters
    ----------
    model : CameraModel or sequence of them
        Several models give the ladder; all are predicted with the same seeds and estimators.
    campaign : Campaign
        With captures.
    jobs : int
        Worker processes.
    say : callable, optional
        Told what is being done.

    Raises
    ------
    InputError
        If nothing can be measured or the sensors differ.
    """
    models = (model,) if isinstance(model, CameraModel) else tuple(model)
    twice = [name for name, count in Counter(m.name for m in models).items() if count > 1]
    if twice:
        raise InputError(f"two models are called {twice[0]!r}; give each its own name in its file")
    with prepare(models[0], campaign, jobs=jobs, say=say) as prepared:
        return comparison_of(prepared, models)


def comparison_of(prepared: Prepared, models: Sequence[CameraModel]) -> Comparison:
    """The comparison of a campaign that is already measured."""
    import pandas as pd

    frames, nuisances = [], {}
    for model in models:
        fitted = prepared.fit_nuisances(model)
        frames.append(_rows(prepared, model, fitted))
        nuisances[model.name] = {f.label: fitted.value(f.label) for f in fitted.free}
    return Comparison(
        table=pd.concat(frames, ignore_index=True),
        ladder=tuple(ladder_rows(prepared, models)),
        gate=repeat_gate(prepared),
        nuisances=nuisances,
        models=tuple(models),
        notes=prepared.table.notes,
        settings={"replicas": prepared.problem.base.replicas, "metrics": int(prepared.problem.keep.size)},
    )


def _rows(prepared: Prepared, model: CameraModel, fitted: Fit) -> pd.DataFrame:
    import pandas as pd

    problem: Problem = prepared.problem_for(model)
    keep = problem.keep
    metrics = [problem.predictor.table.metrics[i] for i in keep]
    names = [n for n in METRIC_FIELDS if n not in NOT_SHOWN]
    frame = pd.DataFrame([[getattr(m, n) for n in names] for m in metrics], columns=names)
    sigma = np.sqrt(np.diag(problem.covariance)[keep])
    frame.insert(0, "model", model.name)
    frame["measured"] = problem.measured[keep]
    frame["simulated"] = fitted.prediction[keep]
    frame["sigma"] = sigma
    frame["z"] = fitted.residual[keep] / sigma
    frame["basis"] = np.where(fitted_to([model], prepared.campaign.name, metrics), CALIBRATION, PREDICTION)
    return frame
