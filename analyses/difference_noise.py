"""How much of a difference between two places of a fit is noise of its draw, in sigmas of the measured rows.

A fit compares places by differences of simulated captures that share their random numbers.  What of them does not cancel moves
chi2 from place to place: by its own square, and by twice its product with what is left.  For the first session of a campaign the
laboratory's unknowns are drawn from their priors, and the difference to the nominal model is taken over eight draws of its noise:
once between frames as a camera gives them, with whole codes, once as `diagnose` takes it.  Frames without noise have one draw.

    python analyses/difference_noise.py CAMPAIGN [--model camera.toml] [--session A]
"""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from pathlib import Path
from unittest.mock import patch

import numpy as np

from isetval import load_campaign, load_model
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare

SEEDS = range(301, 309)  # of differences: no others use them
DRAWN = 11  # seed of the unknowns' place


def as_a_camera_gives_them() -> ExitStack:
    """Differences of whole codes."""
    stack = ExitStack()
    stack.enter_context(patch("isetval.loop.difference_frames.DITHERED_DN2", np.inf))
    return stack


def place_of(problem, rng):
    """The nominal model with every unknown of the laboratory drawn from its prior."""
    values = {f.label: rng.normal() * f.reach for f in problem.plan.unknowns() if not f.owner}
    return Point(problem.origin.model, values)


def measured(problem, there):
    """Whitened differences (seeds, rows) of a place."""
    out = []
    for seed in SEEDS:
        here, moved = problem.predictor.derivative_vectors([problem.origin, there], (seed,))
        out.append(problem.whitened(np.nan_to_num(moved - here)))
    return np.array(out)


def main() -> None:
    """Print both, by family."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", type=Path)
    parser.add_argument("--model", type=Path, help="camera model (default: camera.toml in the campaign's folder)")
    parser.add_argument("--session", help="measurement session (default: the first)")
    asked = parser.parse_args()
    campaign = load_campaign(asked.campaign)
    campaign = campaign.session(asked.session or campaign.sessions[0])
    found = []
    for how in (as_a_camera_gives_them(), ExitStack()):
        with how, prepare(load_model(asked.model or asked.campaign / "camera.toml"), campaign) as ready:
            there = place_of(ready.problem, np.random.default_rng(DRAWN))
            found.append(measured(ready.problem, there))
            families = np.array([ready.problem.predictor.table.metrics[i].family for i in ready.problem.keep])
    print(f"{'family':34s} rows  moved by  noise as taken by a camera  noise as diagnose takes it   (sigmas of all its rows)")
    drawn = sorted({name for name in families if found[0][:, families == name].var(axis=0).any()})
    for name in [*drawn, "all"]:
        own = families == name if name != "all" else np.ones(families.size, bool)
        moved = np.linalg.norm(found[1].mean(axis=0)[own])
        before, now = (np.sqrt(np.sum(part[:, own].var(axis=0, ddof=1))) for part in found)
        print(f"{name:34s} {own.sum():4d}  {moved:8.1f}  {before:26.2f}  {now:26.2f}")


if __name__ == "__main__":
    main()
