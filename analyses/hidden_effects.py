# %% [markdown]
# # Hidden effects: how often does the detective name what is missing?
#
# Question: of campaigns shot by another camera (`isetval.testing.foreign_camera`) with nothing, one effect, two, a wrong
# form or a stranger hidden in them, how many does `isetval.diagnose` answer rightly, and is its stated posterior true?
# Data: campaigns drawn by number and shot here; development and scoring have seeds of their own.
# Result: one row per trial (JSON lines), a table of target | measured | n, `reports/hidden_effects.html` and `.json`.
# Run time: 10 to 100 CPU seconds a trial on the small plan, minutes on the full one.
#
#     python analyses/hidden_effects.py --plan small --first 1570 --n 520 --resume --jobs 2   # run, sum up, write the page
#     python analyses/hidden_effects.py --table                          # the stored table
#     python analyses/hidden_effects.py --make small-scoring-0004 DIR    # one campaign, to look at

# %%
from __future__ import annotations

import argparse
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
ROWS = HERE.parent / "data" / "stored" / "hidden_effects.jsonl"
REPORT = HERE.parent / "reports" / "hidden_effects.html"
CAUSES = HERE.parent / "data" / "stored" / "hidden_effects_causes.json"  # of wrong answers, by trial, written by who looked


def main(words=None):
    """Run what the command line asks for."""
    options = _options(words)
    if options.table:
        print("\n".join(_stored_table(options.report)))
        return 0
    if options.calibrate:
        from hidden_trials.calibrate import calibrate
        from hidden_trials.draw import NOMINAL

        names = tuple(filter(None, options.names.split(",")))
        calibrate(NOMINAL, options.plan, options.lens, names=names, laws_alone=options.laws)
        return 0
    if options.nearest:
        from hidden_trials.draw import NOMINAL
        from hidden_trials.nearest import measure

        measure(NOMINAL, options.plan, options.lens)
        return 0
    if options.signatures:
        from hidden_trials.draw import NOMINAL
        from hidden_trials.own_signature import measure

        measure(NOMINAL, options.plan, options.lens, names=tuple(filter(None, options.names.split(","))))
        return 0
    if options.predict:
        from hidden_trials.predicted import predict

        predict(options.plan)
        return 0
    if options.make:
        return _make(*options.make, options.plan)
    if options.scales:
        from hidden_trials.scales import scale_lines

        print("\n".join(scale_lines(_rows(options.rows))))
        return 0
    if not options.sum_up:
        _run(options)
    _sum_up(options)
    return 0


def _options(words):
    from isetval.testing.foreign_camera.plan import PLANS

    parser = argparse.ArgumentParser(description="Score the detective on campaigns of another camera.")
    parser.add_argument("--n", type=int, default=500, help="trials (default: %(default)s)")
    passed = "trials to pass over, to run or (with --sum-up) to sum up: those that were looked at already"
    parser.add_argument("--first", type=int, default=0, help=passed)
    parser.add_argument("--plan", choices=PLANS, default="edges", help="shots of a campaign (default: %(default)s)")
    parser.add_argument("--kinds", default="null,single,pair,form,outsider", help="what is hidden (default: %(default)s)")
    parser.add_argument(
        "--seeds", choices=("development", "scoring"), default="scoring", help="a rule is changed on the first only"
    )
    parser.add_argument(
        "--names",
        default="",
        help="effects by name in their practical strength, in place of drawn trials; or those to --calibrate or of --signatures",
    )
    parser.add_argument("--jobs", type=int, default=1, help="trials at a time (default: %(default)s)")
    parser.add_argument("--limit-s", type=float, default=900.0, help="wall seconds that a trial may take (default: %(default)s)")
    parser.add_argument("--no-oracle", action="store_true", help="leave out the held-out comparison with the true model")
    parser.add_argument("--resume", action="store_true", help="keep the rows that are there and run the rest")
    parser.add_argument("--rows", type=Path, default=ROWS, help="JSON lines, one a trial")
    parser.add_argument("--keep", type=Path, help="folder that keeps the campaigns (default: they are deleted)")
    parser.add_argument("--report", type=Path, default=REPORT, help="the page; its numbers go beside it as .json")
    parser.add_argument("--sum-up", action="store_true", help="no trials: the page of the rows that are there")
    parser.add_argument("--table", action="store_true", help="print target, measured, n of the stored page")
    parser.add_argument("--scales", action="store_true", help="print how well error bars are known, from the nulls of the rows")
    parser.add_argument("--calibrate", action="store_true", help="measure how strongly effects stand out in a plan")
    parser.add_argument("--laws", action="store_true", help="with --calibrate: only from how many sigmas on stored laws hold")
    parser.add_argument("--predict", action="store_true", help="store the confusions that identify predicts for a plan")
    parser.add_argument("--nearest", action="store_true", help="measure what of each outsider no effect explains in a plan")
    parser.add_argument("--signatures", action="store_true", help="measure how much of each effect its own signature sees")
    parser.add_argument("--lens", choices=("open", "stopped"), default="open", help="setting of the lens to measure in")
    parser.add_argument("--make", nargs=2, metavar=("ID", "DIR"), help="write one trial's campaign and its truth")
    return parser.parse_args(words)


# %%
def _run(options):
    """Run the trials; each row is written when its trial ends, so that a killed run loses the running ones only."""
    from hidden_trials import draw
    from hidden_trials.run import run

    kinds = tuple(options.kinds.split(","))
    if unknown := set(kinds) - set(draw.KINDS):
        raise SystemExit(f"--kinds: {unknown.pop()} is unknown; it needs some of {', '.join(draw.KINDS)}")
    if options.names:
        wanted = [draw.named(name, plan=options.plan) for name in options.names.split(",")]
    else:
        wanted = draw.trials(options.first + options.n, seeds=options.seeds, plan=options.plan, kinds=kinds)[options.first :]
    if options.rows.exists() and not options.resume:
        raise SystemExit(f"{options.rows}: holds rows already; add --resume to go on, or name another file with --rows")
    there = _rows(options.rows)
    if other := {row["plan"] for row in there} - {options.plan}:
        raise SystemExit(f"{options.rows}: holds trials of plan {other.pop()}; name another file with --rows and --report")
    done = {row["id"] for row in there}
    commit = _commit()
    lock, left = Lock(), [t for t in wanted if t.id not in done]
    print(f"{len(wanted)} trials, {len(wanted) - len(left)} of them done", flush=True)

    def one(trial):
        row = run(trial, limit_s=options.limit_s, folder=options.keep, with_oracle=not options.no_oracle)
        row["commit"] = commit
        with lock, options.rows.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        print(line(row), flush=True)

    options.rows.parent.mkdir(parents=True, exist_ok=True)
    if options.rows.is_file() and not options.rows.read_bytes().endswith(b"\n"):
        with options.rows.open("a", encoding="utf-8") as file:
            file.write("\n")  # ends the line that a killed run left half written
    with ThreadPoolExecutor(options.jobs) as pool:
        list(pool.map(one, left))


def _commit():
    """The commit that runs, "+" where files of it were changed since; empty without git."""

    def said(*words):
        try:
            done = subprocess.run(["git", "-C", str(HERE), *words], capture_output=True, text=True, check=False)
        except OSError:
            return ""
        return done.stdout.strip() if done.returncode == 0 else ""

    commit = said("rev-parse", "--short=12", "HEAD")
    return commit + "+" * bool(commit and said("status", "--porcelain", "-uno"))


def line(row):
    """A row in words."""
    from hidden_trials.judge import judged

    j = judged(row)
    hidden = " + ".join(row["hidden"]) or "nothing"
    s = "/".join("?" if s is None else f"{s:.0f}" for s in row["expected_s"])
    said = f"{j.get('verdict', '-')}: {', '.join(j['named']) or 'nothing'}"
    mark = "ok  " if j["right"] else "MISS"
    return f"{mark} {row['id']:26s} {hidden:36s} s {s:6s} {j['outcome']:22s} {said} | {row['cpu_s']:.0f} s"


def _rows(path):
    """Rows of a file; a last line that a killed run left half written is passed over."""
    out = []
    for text in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
        try:
            out.append(json.loads(text))
        except ValueError:
            continue
    return out


# %%
def _sum_up(options):
    from hidden_trials.draw import restated_s
    from hidden_trials.judge import judged
    from hidden_trials.page import write_page
    from hidden_trials.predicted import held_against
    from hidden_trials.summary import summary, table_lines

    import isetval

    least = options.first if options.sum_up else 0
    run = [row | {"expected_s": restated_s(row)} for row in _rows(options.rows) if _number(row) >= least]
    empty = [row["id"] for row in run if row["hidden"] and not row.get("changes_bits", True)]
    lawless = [row["id"] for row in run if isinstance(row["level"], float) and None in row["expected_s"]]
    rows = [(row, judged(row)) for row in run if row["id"] not in (*empty, *lawless)]
    if not rows:
        raise SystemExit(f"{options.rows}: no rows yet")
    made = {"isetval": isetval.__version__, "date": datetime.now(UTC).strftime("%Y-%m-%d")}
    made["commits"] = sorted({row.get("commit") or "not known" for row, _ in rows})
    made["empty"] = empty  # an effect hidden by name, in no bit of any frame: neither a null nor an effect, nor one of two
    made["lawless"] = lawless  # hidden for so many sigmas, which is below where the law of their strength begins
    found = {**made, **_sets(rows), **summary(rows), "confusions": held_against(rows)}
    causes = json.loads(CAUSES.read_text(encoding="utf-8")) if CAUSES.is_file() else {}
    for wrong in found["wrong"]:
        wrong["cause"] = causes.get(wrong["id"], "")
    options.report.parent.mkdir(parents=True, exist_ok=True)
    options.report.with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    write_page(found, options.report)
    print("\n".join(table_lines(found)))
    if empty:
        print(f"left out, since of an effect that is hidden no frame has a bit: {', '.join(empty)}")
    if lawless:
        print(f"left out, since how far they stand out by is not known: {', '.join(lawless)}")
    for wrong in found["wrong"]:
        print(f"wrong: {wrong['id']} ({wrong['outcome']}): {wrong['why']}")
    print(f"written: {options.report}")


def _number(row):
    """Which of its set a trial is; of one by its effect's name 0."""
    number = row["id"].rsplit("-", 1)[1]
    return int(number) if number.isdigit() else 0


def _sets(rows):
    """Which plans and seeds the rows are of."""
    return {"plans": sorted({r["plan"] for r, _ in rows}), "sets": sorted({r["id"].rsplit("-", 1)[0] for r, _ in rows})}


def _stored_table(report):
    from hidden_trials.summary import table_lines

    path = report.with_suffix(".json")
    if not path.is_file():
        raise SystemExit(f"{path}: not there; run this script first")
    found = json.loads(path.read_text(encoding="utf-8"))
    commits = ", ".join(found.get("commits", ("not known",)))
    head = f"{found['n']} trials ({', '.join(found['sets'])}), isetval {found['isetval']} at {commits}, {found['date']}"
    return [head, *table_lines(found)]


def _make(name, folder, plan):
    """A trial's campaign in a folder, and what is hidden in it beside it; of an effect by its name in this plan."""
    from hidden_trials.draw import NOMINAL, named

    from isetval.testing.foreign_camera.campaign import write_campaign

    t, truth = named(name, plan=plan), Path(f"{folder}.truth.json")
    if Path(folder).exists() or truth.exists():
        raise SystemExit(f"{folder}, or {truth.name} beside it: is there already; name a folder that is not")
    write_campaign(folder, NOMINAL, seed=t.seed, hidden=t.hidden, kind=t.plan, lens=t.lens, other_specimen=t.other_specimen)
    truth.write_text(json.dumps(t.row(), indent=1) + "\n", encoding="utf-8")
    print(f"{folder}: truth in {truth}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
