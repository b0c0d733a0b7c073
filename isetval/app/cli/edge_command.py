"""``isetval edge``: a slanted edge whose MTF is known exactly, as a DNG: to try any tool that measures sharpness."""

from __future__ import annotations

import argparse
from typing import Any

from isetval.app.cli.console import Console
from isetval.app.cli.outcome import FINE, Outcome
from isetval.core.errors import InputError

LEVELS = (0.5, 0.3, 0.1)


def register(commands: Any, common: argparse.ArgumentParser) -> None:
    """The command and its options."""
    p = commands.add_parser("edge", parents=[common], help="a DNG of an edge with known MTF", description=edge.__doc__)
    p.add_argument("--angle-deg", type=float, default=5.0, help="angle of the edge (default: %(default)s)")
    p.add_argument("--sigma-px", type=float, default=0.6, help="Gaussian blur beside the pixel's aperture (default: %(default)s)")
    p.add_argument("--size", type=int, default=200, help="rows and columns (default: %(default)s)")
    p.set_defaults(handler=edge, writes_result=False, suffixes=(".dng",))


def edge(args: argparse.Namespace, console: Console) -> Outcome:
    """Write a noise-free slanted edge of known blur as a DNG, and tell its true MTF50, 30 and 10 (integrated, not measured)."""
    import isetval
    from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture

    if args.output is None:
        raise InputError("edge needs -o NAME.dng: the file to write")
    if not (0 <= args.sigma_px <= 10 and 32 <= args.size <= 4000 and abs(args.angle_deg) <= 360):
        raise InputError("edge needs --sigma-px from 0 to 10, --size from 32 to 4000, --angle-deg from -360 to 360")
    truth = EdgeTruth(EdgeBlur(gaussian_sigma_px=args.sigma_px), angle_deg=args.angle_deg)
    isetval.write_dng(args.output, edge_capture(truth, shape=(args.size, args.size)))
    known = {f"mtf{100 * level:.0f}_cy_px": truth.mtf50_cy_px(level) for level in LEVELS}
    lines = [f"{args.output}: " + ", ".join(f"{name.partition('_')[0].upper()} {v:.5f} cy/px" for name, v in known.items())]
    return Outcome({"kind": "edge", "file": args.output, **known}, lines, FINE)
