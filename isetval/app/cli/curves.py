"""A curve from a file in the place of a campaign: options and reading."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from isetval.camera.model import CameraModel
    from isetval.core.campaign import Campaign

OPTIONS = ("sigma", "correlation", "channel", "column", "edge", "method")


def curve_options(p: argparse.ArgumentParser) -> None:
    """Options of a curve."""
    group = p.add_argument_group("a curve in the place of the campaign (README, metrics)")
    group.add_argument("--as", dest="curve", metavar="NAME", help="what it is: relative_illumination, mtf, noise, sensor_numbers")
    group.add_argument("--sigma", type=float, help="standard deviation of every row that states none")
    group.add_argument(
        "--correlation-mm", "--correlation-length", dest="correlation", type=float,
        help="rows correlate with exp(-distance/length); length in the axis's unit (mm, cy/px, DN)",
    )  # fmt: skip
    group.add_argument("--channel", help="only rows of this channel, or the channel of rows that name none")
    group.add_argument("--column", help="which column holds the values, where there are several")
    group.add_argument("--edge", type=int, help="which edge or region of the file, from 1")
    group.add_argument("--method", help="own, lyu2022, iso12233:2000, iso12233:2014, iso12233:2017, iso12233:2023")


def shots_of(model: CameraModel, path: str, args: argparse.Namespace | None, *, as_plan: bool = False) -> Campaign:
    """The campaign at ``path``, or the curve at ``path`` as a campaign of one shot; ``as_plan``, its captures need not be there.

    Raises
    ------
    InputError
        For options of a curve without --as, and whatever the files deserve.
    """
    import isetval
    from isetval.core.errors import InputError

    if args is None or args.curve is None:
        given = [name for name in OPTIONS if args is not None and getattr(args, name) is not None]
        if given:
            raise InputError(f"--{given[0]} is said of a curve; say what the file holds with --as, as --as relative_illumination")
        campaign: Campaign = isetval.load_campaign(path, as_plan=as_plan)
        return campaign
    from isetval.files.metric_file import Reading
    from isetval.loop.curve_campaign import curve_campaign

    how = Reading(
        column=args.column or "",
        sigma=args.sigma,
        channel=args.channel or "",
        edge=args.edge,
        method=args.method or "",
        correlation_length=args.correlation or 0.0,
    )
    return curve_campaign(model, path, name=args.curve, how=how)
