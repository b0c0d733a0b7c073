"""Faults at random moments, again and again: what was tried and survived, as JSON.

    python tests/batch/fault_campaign.py --rounds 20 --seed 1 [-o reports/faults.json]

Each round meets every fault of `faults.FAULTS` once on a folder of its own captures, and each time the same command must end with
the quiet run's result to the last bit, without litter in the store and without an orphaned worker.
"""

import argparse
import collections
import json
import shutil
import sys
import tempfile
import time
from pathlib import Path

from faults import FAULTS, Lab, run_fault


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--files", type=int, default=72)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    survived, failed = collections.Counter(), []
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        lab = Lab(folder, files=args.files)
        for number in range(args.rounds):
            for fault in FAULTS:
                try:
                    run_fault(lab, fault, number, args.seed)
                    survived[fault] += 1
                except AssertionError as error:
                    failed.append(f"{fault} {number}: {error}"[:500])
                for path in Path(folder).glob(f"{fault}_{number}*"):
                    shutil.rmtree(path) if path.is_dir() else path.unlink()
                print(f"{fault} {number}: {len(failed)} failed so far", file=sys.stderr)
    result = {"rounds": args.rounds, "seed": args.seed, "files": args.files, "survived": dict(survived), "failed": failed}
    text = json.dumps(result | {"seconds": round(time.monotonic() - start)}, indent=1)
    print(text)
    if args.output:
        args.output.write_text(text + "\n")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
