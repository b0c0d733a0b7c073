"""Every reader of JSON and TOML against damaged files.

    python tests/fuzz/text_campaign.py --files 100000 --seed 1 [-o log.json] [--only model,plan] [--keep DIR]
    python tests/fuzz/text_campaign.py --merge log1.json log2.json -o reports/fuzzing_text.json

Counts, the slowest file and every finding are printed as JSON; a file that breaks the rule is kept.
"""

import argparse
import collections
import json
import resource
import sys
import time
import traceback
from pathlib import Path

import numpy as np
from text_mutants import SECONDS, Slow, all_readers, mutant, timed

SLOW = ("plan", "report demo", "report comparison", "report diagnosis", "lens")  # cost 5 to 20 ms a file: a quarter of the others


def merged(logs, output):
    """The logs of campaigns with other seeds as one."""
    sums = {key: collections.Counter() for key in ("counts", "findings")}
    for log in logs:
        for key, counter in sums.items():
            counter.update(log[key])
    worst = max(logs, key=lambda log: log["slowest_s"])
    result = {"files": sum(log["files"] for log in logs), "seeds": [log["seed"] for log in logs]}
    result |= {key: dict(sorted(counter.items())) for key, counter in sums.items()}
    result |= {"slowest_s": worst["slowest_s"], "slowest": worst["slowest"]}
    result |= {"peak_growth_mb": max(log["peak_growth_mb"] for log in logs), "cpu_s": sum(log["cpu_s"] for log in logs)}
    output.write_text(json.dumps(result, indent=1) + "\n")
    return int(bool(result["findings"]))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="")
    parser.add_argument("--keep", type=Path, default=Path("/tmp/text_mutants"))
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--merge", type=Path, nargs="+", help="logs of earlier campaigns, made one")
    args = parser.parse_args()
    if args.merge:
        return merged([json.loads(path.read_text()) for path in args.merge], args.output)
    rng = np.random.default_rng(args.seed)
    counts, findings, slowest = collections.Counter(), collections.Counter(), (0.0, "")
    start = time.process_time()
    with all_readers() as readers:
        names = args.only.split(",") if args.only else list(readers.files)
        for name in names:
            assert timed(readers, name, readers.files[name][1])[0] == "read", name
        chances = np.array([1.0 if name in SLOW else 4.0 for name in names])
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        for number in range(args.files):
            name = str(rng.choice(names, p=chances / chances.sum()))
            suffix, whole, _ = readers.files[name]
            data = mutant(whole, suffix, rng)
            try:
                word, seconds = timed(readers, name, data)
            except (Exception, Slow) as error:
                word, seconds = "broken", 0.0
                trace = traceback.extract_tb(error.__traceback__)
                own = [f for f in trace if "/isetval/" in f.filename]
                where = f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else "?"
                key = f"{name}: {type(error).__name__} at {where}: {str(error)[:80]}"
                if not findings[key]:
                    args.keep.mkdir(exist_ok=True)
                    (args.keep / f"{name.replace(' ', '_')}_{args.seed}_{number}{suffix}").write_bytes(data)
                findings[key] += 1
            counts[f"{name}: {word}"] += 1
            slowest = max(slowest, (seconds, f"{name} {number}"))
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1e3
    result = {"files": args.files, "seed": args.seed, "counts": dict(sorted(counts.items()))}
    result |= {"findings": dict(findings.most_common()), "slowest_s": slowest[0], "slowest": slowest[1]}
    result |= {"peak_growth_mb": grown, "cpu_s": round(time.process_time() - start)}
    text = json.dumps(result, indent=1)
    print(text)
    if args.output:
        args.output.write_text(text + "\n")
    return int(bool(findings) or slowest[0] > SECONDS)


if __name__ == "__main__":
    sys.exit(main())
