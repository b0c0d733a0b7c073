"""Damage to DNG files, led by what the reader's code has not done yet (atheris: libFuzzer for Python; `pip install atheris`).

    python tests/fuzz/guided_campaign.py --files 100000 --seed 1 -o reports/fuzzing_guided.json

The rule is that of `tests/dng/mutation_campaign.py`: a capture or one sentence, within 2 s and 1 GB, never a frame of one value.
A file that breaks it ends the campaign and is kept in --keep.
"""

import argparse
import collections
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "dng"))
SAID_EVERY = 500


def fuzz(folder, files, seed, keep):
    """The child: libFuzzer ends the process, so that counts are written as it goes."""
    import atheris

    with atheris.instrument_imports(include=["isetval.files", "tifffile"]):
        from isetval import read_dng
        from isetval.files.dng import reader  # noqa: F401  instrumented before anything else imports it
    from mutation_campaign import BYTES, SECONDS, originals, outcome

    corpus = folder / "corpus"
    corpus.mkdir()
    for number, data in enumerate(originals().values()):
        (corpus / f"whole_{number}").write_bytes(data)
    counts, path = collections.Counter(), folder / "mutant"
    # memory counts the interpreter and the instrumented libraries too
    options = [f"-runs={files}", f"-seed={seed}", f"-timeout={int(SECONDS)}", f"-rss_limit_mb={BYTES // 2**20 + 500}"]
    options += ["-print_final_stats=1", "-max_len=20000", f"-artifact_prefix={keep}/", str(corpus)]

    def one(data):
        path.write_bytes(data)
        word, _ = outcome(read_dng, path)
        counts[word] += 1
        if sum(counts.values()) % SAID_EVERY == 0:
            (folder / "counts.json").write_text(json.dumps(counts))

    atheris.Setup([sys.argv[0], *options], one)
    atheris.Fuzz()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=Path("mutants"))
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    if args.child:
        return fuzz(args.child, args.files, args.seed, args.keep)
    args.keep.mkdir(exist_ok=True, parents=True)
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, __file__, "--files", str(args.files), "--seed", str(args.seed), "--keep", str(args.keep)]
        done = subprocess.run([*words, "--child", folder], stderr=subprocess.PIPE, text=True, env=dict(os.environ))
        file = Path(folder) / "counts.json"
        counts = json.loads(file.read_text()) if file.exists() else {}
    stats = {key: int(value) for key, value in re.findall(r"stat::(\w+):\s+(\d+)", done.stderr)}
    coverage = [int(n) for n in re.findall(r"cov: (\d+)", done.stderr)]
    result = {"files": stats.get("number_of_executed_units", 0), "seed": args.seed, "counts": counts}
    result |= {"coverage_first_last": [coverage[0], coverage[-1]] if coverage else [], "peak_mb": stats.get("peak_rss_mb")}
    result |= {"broken": [] if done.returncode == 0 else done.stderr[-3000:].splitlines()}
    text = json.dumps(result, indent=1)
    print(text)
    if args.output:
        args.output.write_text(text + "\n")
    return int(done.returncode != 0)


if __name__ == "__main__":
    sys.exit(main())
