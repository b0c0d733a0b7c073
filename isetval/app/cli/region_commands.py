"""``isetval roi``, and measuring the regions that were drawn: ``isetval measure IMAGE --regions FILE``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isetval.app.cli.console import Console
from isetval.app.cli.outcome import BAD_INPUT, FINE, Outcome
from isetval.app.cli.tables import text_table
from isetval.app.words import with_sigma
from isetval.core.errors import InputError, MeasurementError

if TYPE_CHECKING:
    from isetval.core.capture import Capture
    from isetval.files.region_file import Regions


def register(commands: Any, common: argparse.ArgumentParser) -> None:
    """The command and its options."""
    p = commands.add_parser("roi", parents=[common], help="a page to draw regions into a capture", description=roi.__doc__)
    p.add_argument("image", metavar="IMAGE", type=Path, help="a raw file, or a picture with its sidecar")
    p.add_argument("--open", action="store_true", help="open the page")
    p.set_defaults(handler=roi, writes_result=False, suffixes=(".html", ".htm"))


def roi(args: argparse.Namespace, console: Console) -> Outcome:
    """Write a page on which edges, patches and lines are drawn into a capture, with mouse or finger, and downloaded as TOML."""
    import isetval
    from isetval.app.report.roi_page import roi_html
    from isetval.core.cache import file_hash
    from isetval.core.writing import write_whole

    if args.output is None:
        raise InputError("roi needs -o PAGE.html: the file to write")
    console.say(f"reading {args.image}")
    capture = isetval.read_capture(args.image)
    write_whole(args.output, roi_html(capture, args.image.name))
    lines = [f"{args.output}: draw regions, download regions.toml, then: isetval measure {args.image} --regions regions.toml"]
    return Outcome({"kind": "roi", "page": args.output}, lines, FINE, {str(args.image): file_hash(args.image)})


def measure_regions(args: argparse.Namespace, console: Console) -> Outcome:
    """Every region of a file in every capture: SFR of edges, means of patches, profiles of lines."""
    import isetval
    from isetval.core.cache import file_hash
    from isetval.files.loose_files import raw_files
    from isetval.files.region_file import read_regions

    regions = read_regions(args.regions)
    paths = raw_files(args.paths)
    rows: list[dict[str, Any]] = []
    skipped: list[dict[str, str]] = []
    for i, path in enumerate(paths):
        console.progress(f"measuring {path.name}", i, len(paths))
        try:
            capture = isetval.read_capture(path)
            rows += [row | {"file": str(path)} for row in region_rows(capture, regions, args.channel or "G", args.method)]
        except InputError as error:
            skipped.append({"file": str(path), "reason": str(error)})
    hashes = {str(path): file_hash(path) for path in (*paths, args.regions)}
    body = [(r["name"], r["region"], r["channel"], with_sigma(r["value"], r["sigma"], r["unit"]), r["reason"]) for r in rows]
    lines = text_table(("metric", "region", "channel", "value", "flags"), [row for row in body if row[0] != "line_profile"])
    lines += [f"left out: {s['file']}: {s['reason']}" for s in skipped]
    result = {"kind": "measure", "metrics": rows, "skipped": skipped, "notes": [], "settings": {"regions": str(args.regions)}}
    return Outcome(result, lines, FINE if rows else BAD_INPUT, hashes, rows)


def region_rows(capture: Capture, regions: Regions, channel: str, method: str) -> list[dict[str, Any]]:
    """One row a number; a region that is refused has its reason and no value."""
    from isetval.measure import chart, line_profile, sfr

    channel = "MONO" if capture.sensor.cfa == "MONO" else channel
    rows = []
    for name, box in regions.edges:
        try:
            result = sfr(capture, box, channel, method=method or "default")
        except MeasurementError as error:
            rows.append(_row("mtf50", name, channel, None, None, "cy/px", str(error)))
            continue
        flags = ", ".join(result.flags)
        rows.append(_row("mtf50", name, channel, result.mtf50_cy_px, result.mtf50_sigma, "cy/px", flags))
        rows.append(_row("edge_angle", name, channel, result.angle_deg, None, "deg", flags))
    if regions.patches:
        found = chart(capture, boxes=[box for _, box in regions.patches], names=[name for name, _ in regions.patches])
        frame = found.to_frame()
        rows += [_row("patch_mean", r.patch, r.channel, r.value, r.sigma, r.unit) for r in frame.itertuples()]
    for name, start, end in regions.lines:
        profile = line_profile(capture, start, end).to_frame()
        profile = profile[(profile.name == "line_profile") & ~profile.channel.isin(["Gr", "Gb"])]
        rows += [
            _row("line_profile", name, r.channel, r.value, r.sigma, r.unit) | {"position_um": r.position_um}
            for r in profile.itertuples()
        ]
        for plane, part in profile.groupby("channel", sort=False):
            mean, count = float(part.value.mean()), len(part)
            sigma = float((part.sigma**2).sum() ** 0.5) / count
            rows.append(_row("line_mean", name, str(plane), mean, sigma, "DN"))
    return rows


def _row(name: str, region: str, channel: str, value: Any, sigma: Any, unit: str, reason: str = "") -> dict[str, Any]:
    return {"name": name, "region": region, "channel": channel, "value": value, "sigma": sigma, "unit": unit, "reason": reason}
