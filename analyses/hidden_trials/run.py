"""One trial in a process of its own: campaign written, ``isetval`` asked by its public interface, the answer written down.

``python -m hidden_trials.run TRIAL.json FOLDER ANSWER.json`` from the folder ``analyses``.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from hidden_trials.draw import NOMINAL

HERE = Path(__file__).resolve().parents[1]


def run(trial, *, limit_s, folder=None, with_oracle=True):
    """The row of a trial: its description, the answer, CPU and wall seconds; an answer that did not come says why.

    CPU seconds are those of the diagnosis alone, as its process counts them: a parent's sum over its children holds those of
    trials that ran beside it.  Where no answer came they are the wall seconds.
    """
    with tempfile.TemporaryDirectory() as scratch:
        where = Path(folder) / trial.id if folder else Path(scratch) / "campaign"
        said, answer = Path(scratch) / "trial.json", Path(scratch) / "answer.json"
        said.write_text(json.dumps(trial.row() | {"with_oracle": with_oracle}), encoding="utf-8")
        words = [sys.executable, "-m", "hidden_trials.run", str(said), str(where), str(answer)]
        path = os.pathsep.join([str(HERE), str(HERE.parent), os.environ.get("PYTHONPATH", "")])
        start = time.perf_counter()
        try:
            done = subprocess.run(
                words, timeout=limit_s, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": path}, check=False
            )
            error = None if done.returncode == 0 else done.stderr.strip().splitlines()[-1][:400]
        except subprocess.TimeoutExpired:
            error = f"not done within {limit_s:g} s"
        row = trial.row() | {"wall_s": round(time.perf_counter() - start, 1)}
        found = json.loads(answer.read_text(encoding="utf-8")) if answer.is_file() else None
        row["cpu_s"] = (found or {}).get("diagnose_cpu_s", row["wall_s"])
        return row | {"error": error, "answer": found, "changes_bits": not row["hidden"] or changes_bits(row)}


def main(words):
    """Write, diagnose, compare with the oracle; each part is written down as soon as it is there."""
    import isetval
    from isetval.testing.foreign_camera.campaign import write_campaign

    told, where, answer = json.loads(Path(words[0]).read_text(encoding="utf-8")), Path(words[1]), Path(words[2])
    if not (where / "campaign.toml").is_file():
        write_campaign(
            where, NOMINAL, seed=told["seed"], hidden=told["hidden"], kind=told["plan"], lens=told["lens"],
            other_specimen=told["other_specimen"],
        )  # fmt: skip
    model, campaign = isetval.load_model(where / "camera.toml"), isetval.load_campaign(where)
    start = time.process_time()
    found = isetval.diagnose(model, campaign, with_next_captures=False)
    out = _short(found.to_json()) | {"diagnose_cpu_s": round(time.process_time() - start, 1)}
    answer.write_text(json.dumps(out), encoding="utf-8")
    true = oracle(told, model) if told["with_oracle"] else None
    if true is not None:
        rows = isetval.compare([model, true], campaign.session("B")).ladder
        out["oracle"] = [vars(row) for row in rows if row.model == "oracle"]
        answer.write_text(json.dumps(out), encoding="utf-8")


def changes_bits(row):
    """Whether each effect that is hidden changes any bit of any frame that the same specimen gives without it.

    What acts on whole codes and moves none of them by half a code is not there, whatever the law of its strength says: of a pair
    with such a one a single effect is left, which is no pair.
    """
    from isetval.testing.foreign_camera import plan
    from isetval.testing.foreign_camera.camera_file import nominal_camera
    from isetval.testing.foreign_camera.campaign import in_setting, lights_of, shoot
    from isetval.testing.foreign_camera.sensor import specimen_of

    nominal = in_setting(nominal_camera(NOMINAL / "camera.toml", str(NOMINAL / "qe.csv")), row["lens"])
    lights, priors, seed = lights_of(nominal), plan.priors(row["plan"]), row["seed"]
    session = plan.session(nominal, "A", row["plan"])

    def frames(hidden):
        specimen = specimen_of(nominal, seed, hidden)
        return (shoot(p, specimen, lights, seed, priors=priors) for p in session)

    def differs(hidden):
        return any((a != b).any() for a, b in zip(frames(hidden), frames({}), strict=True))

    return all(differs({key: values}) for key, values in row["hidden"].items())


def _short(content):
    """What is judged and shown of a diagnosis."""
    candidates = sorted(content["candidates"], key=lambda row: -(row["dchi2"] or 0))[:8]
    kept = ("name", "dchi2", "dof", "p_corrected", "posterior", "log_evidence")
    return {
        "verdict": content["verdict"],
        "effects": content["effects"],
        "leftover": content["leftover"],
        "probabilities": content["probabilities"],
        "not_looked_at": content["not_looked_at"],
        "gate": content["gate"],
        "holdout": content["holdout"],
        "ladder": content["ladder"],
        "notes": content["notes"],
        "unobservable": content["unobservable"],
        "candidates": [{key: row.get(key) for key in kept} for row in candidates],
    }


def oracle(told, model):
    """The nominal model with the true effects at their true values, or None where the catalogue has no such numbers."""
    from dataclasses import replace

    from isetval.effects import catalogue

    truths = told["truths"]
    if not truths or not all(truth["values"] for truth in truths):
        return None
    for truth in truths:
        effect = model.effect(truth["name"]) or catalogue()[truth["name"]]()
        read = {p.name for p in effect.own_parameters()}  # of another form of it the trial states the same anew
        model = model.with_effect(effect.changed(**{key: value for key, value in truth["values"].items() if key in read}))
    return replace(model, name="oracle")


if __name__ == "__main__":
    main(sys.argv[1:])
