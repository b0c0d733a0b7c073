"""The whole speed table: what is asked, what was measured, CPU and wall apart, the load beside it.

    python -m tests.benchmarks [--only dng,measure,sfr,photon,chain,lens,weights,loop] [--files 1000] [-o table.json]

Every ratio is of times that were taken in turns within one run, so that a busy machine slows both sides; CPU times still grow by
some ten percent where others use the caches.  About ten minutes where nobody else is.
"""

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import archive_scale
import block_weights
import dng_reading
import lens_diagnosis
import loop_speed
import photon_transfer_speed
import sensor_chain_speed
import sfr_speed
from timing import table_lines


def dng(args):
    with tempfile.TemporaryDirectory() as folder:
        return dng_reading.rows(Path(folder))


PARTS = {
    "dng": dng,
    "measure": lambda args: archive_scale.rows_of(archive_scale.measured(args.files)),
    "sfr": lambda args: sfr_speed.rows(),
    "photon": lambda args: photon_transfer_speed.rows(),
    "chain": lambda args: sensor_chain_speed.rows(),
    "lens": lambda args: lens_diagnosis.rows(),
    "weights": lambda args: block_weights.rows(),
    "loop": lambda args: loop_speed.rows(),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(PARTS), help="parts, by comma (default: all of %(default)s)")
    parser.add_argument("--files", type=int, default=1000, help="the largest number of small files")
    parser.add_argument("-o", "--output", type=Path, help="the rows as JSON")
    args = parser.parse_args()
    load, found = os.getloadavg()[0], []
    for part in args.only.split(","):
        print(f"measuring {part}", file=sys.stderr)
        found += PARTS[part](args)
        if args.output:  # after each part: the others take minutes
            rows = [vars(row) | {"name": row.name.strip(), "met": row.met} for row in found]
            loads = (load, os.getloadavg()[0])
            args.output.write_text(json.dumps({"rows": rows, "load": loads, "cores": os.cpu_count()}, indent=1) + "\n")
    print("\n".join(table_lines(found, (load, os.getloadavg()[0]))))


if __name__ == "__main__":
    main()
