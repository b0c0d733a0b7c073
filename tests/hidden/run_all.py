"""Run all hidden-effect trials, print the table, store the results: ``python tests/hidden/run_all.py``."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from datetime import UTC, datetime
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]
STORED = HERE.parents[1] / "data" / "stored" / "hidden_effects.json"


def main(arguments=None):
    """Run the trials that are asked for."""
    from foreign_camera.truths import TRIALS
    from trials import run_trial

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="trials (default: all)")
    parser.add_argument("--kind", choices=("effect", "null", "outsider"), help="only trials of one kind")
    parser.add_argument("--seed-shift", type=int, default=0, help="other draws than those that count (for development)")
    parser.add_argument("--short", action="store_true", help="the plan of darks and flats only")
    parser.add_argument("--store", type=Path, help=f"write the results here (the kept ones lie in {STORED.name})")
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.names) - set(TRIALS))
    if unknown:
        parser.error(f"no trial is called {unknown[0]}; there are: {', '.join(TRIALS)}")
    names = options.names or [n for n, t in TRIALS.items() if options.kind in (None, t.kind)]
    outcomes = []
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            outcomes.append(run_trial(name, Path(folder) / name, seed_shift=options.seed_shift, short=options.short))
        print(line(outcomes[-1]), flush=True)
        if options.store:
            store(options.store, outcomes, options.seed_shift)
    print(summary(outcomes))
    return 0


def line(outcome):
    """One row of the table."""
    named = ", ".join(f"{name}{'~' + '~'.join(same) if same else ''}" for name, _, same in outcome.effects) or "-"
    sigmas = " ".join(f"{value:+.1f}" for value in outcome.value_sigmas.values())
    held = " ".join(f"{key} {value:.3f}" for key, value in outcome.held_out.items())
    s = "" if outcome.s is None else f"s {outcome.s:5.1f}"
    mark = "ok  " if outcome.holds else "MISS"
    reason = "" if outcome.holds else " | " + "; ".join(outcome.why)
    words = f" | left: {outcome.leftover[:160]}" if outcome.leftover else ""
    text = f"{mark} {outcome.name:20s} {s:8s} {outcome.verdict:12s} {named} | off by {sigmas or '-'} sigma | {held}"
    return f"{text} | {outcome.seconds:.0f} s{reason}{words}"


def summary(outcomes):
    """How many of each kind hold."""
    parts = []
    for kind in ("effect", "null", "outsider"):
        own = [o for o in outcomes if o.kind == kind]
        if own:
            parts.append(f"{kind}s: {sum(o.holds for o in own)} of {len(own)} hold")
    extra = sum(bool(o.extra) for o in outcomes if o.kind == "effect")
    return "; ".join(parts) + f"; effects with a further name: {extra}"


def store(path, outcomes, seed_shift):
    """Keep the results as JSON, dated."""
    import isetval

    content = {
        "what": "hidden-effect trials: truth from tests/foreign_camera, judged by tests/hidden/run_all.py",
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "isetval": isetval.__version__,
        "seed_shift": seed_shift,
        "summary": summary(outcomes),
        "trials": [o.row() for o in outcomes],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
