"""How much of a difference between two places of a fit is noise of its draw, in sigmas of the measured rows.

A fit compares places by differences of simulated captures that share their random numbers.  What of them does not cancel moves
chi2 from place to place: by its own square, and by twice its product with what is left.  For the first session of a campaign the
laboratory's unknowns are drawn from their priors, and the difference to the nominal model is taken over eight draws of its noise:
once between frames as a camera gives them, with whole codes, once as `diagnose` takes it.  Frames without noise have one draw.

    python analyses/difference_noise.py CAMPAIGN [--model camera.toml] [--session A]
"""

from __future__ import annotations

import argparse
from pathlib import Path
from unittest.mock import patch

import numpy as np

from isetval import InputError, load_campaign, load_model
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare

SEEDS = range(301, 309)  # of differences: no others use them
DRAWN = 11  # seed of the unknowns' place


def place_of(problem, rng):
    """The nominal model with every unknown of the laboratory drawn from its prior."""
    values = {f.label: rng.normal() * f.reach for f in problem.plan.unknowns() if not f.owner}
    return Point(problem.origin.model, values)


def differences(problem, there):
    """Whitened differences (seeds, rows) of a place."""
    out = []
    for seed in SEEDS:
        here, moved = problem.predictor.derivative_vectors([problem.origin, there], (seed,))
        out.append(problem.whitened(np.nan_to_num(moved - here)))
    return np.array(out)


def report(families, whole, taken):
    """Lines of a table: by family what moves, the noise of differences of whole codes, and that of those that are taken."""
    yield f"{'family':34s} rows  moved by  noise of whole codes  noise as taken   (sigmas of all its rows)"
    drawn = sorted({name for name in families if whole[:, families == name].var(axis=0).any()})
    for name in [*drawn, "all"]:
        own = families == name if name != "all" else np.ones(families.size, bool)
        moved = np.linalg.norm(taken.mean(axis=0)[own])
        noise = [np.sqrt(np.sum(part[:, own].var(axis=0, ddof=1))) for part in (whole, taken)]
        yield f"{name:34s} {own.sum():4d}  {moved:8.1f}  {noise[0]:20.2f}  {noise[1]:14.2f}"


def main() -> None:
    """Print both, by family."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", type=Path)
    parser.add_argument("--model", type=Path, help="camera model (default: camera.toml in the campaign's folder)")
    parser.add_argument("--session", help="measurement session (default: the first)")
    asked = parser.parse_args()
    try:
        campaign = load_campaign(asked.campaign)
        campaign = campaign.session(asked.session or campaign.sessions[0])
        with prepare(load_model(asked.model or asked.campaign / "camera.toml"), campaign) as ready:
            problem = ready.problem
            there = place_of(problem, np.random.default_rng(DRAWN))
            taken = differences(problem, there)
            with patch("isetval.loop.difference_frames.DITHERED_DN2", np.inf):
                whole = differences(problem, there)
            families = np.array([problem.predictor.table.metrics[i].family for i in problem.keep])
    except InputError as error:
        raise SystemExit(str(error)) from None
    print(*report(families, whole, taken), sep="\n")


if __name__ == "__main__":
    main()
