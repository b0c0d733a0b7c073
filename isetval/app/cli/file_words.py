"""Words for measured files: what was read, which black level, clipped and bad pixels, patches, edges."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from isetval.app.cli.tables import text_table
from isetval.app.remarks import warnings_of
from isetval.app.words import with_sigma

if TYPE_CHECKING:
    from isetval.core.metric import Metric

MAX_ROWS = 60
MAX_REJECTED = 8  # edges of one file that are named one by one
REJECTED = re.compile(r"(?P<file>.*?)edge rejected at [\d,]+: (?P<reason>[^:;,(]+)")


def file_lines(file: str, about: Mapping[str, Any]) -> list[str]:
    """One file: geometry, exposure, black level, doubts."""
    if "shape" not in about:
        return []
    rows, cols = about["shape"]
    lines = [f"# {file}", f"  {_sensor_words(about)}{_exposure_words([about])}"]
    lines.append(f"  black level: {_black_words(about)}")
    lines.append(f"  {_clipped_words(about)}")
    bad = about["bad_pixels"]
    lines.append(f"  bad pixels: {bad['hot']} hot, {bad['dead']} dead (of {rows * cols}; the rim is not judged)")
    return lines + [f"  warning: {w['message']}" for w in about["warnings"]]


def folder_lines(files: Mapping[str, Mapping[str, Any]], quality: Sequence[str]) -> list[str]:
    """Many files: each kind of them with its shortest and longest exposure, the verdicts, and what the readers warn of."""
    kinds: dict[str, list[Mapping[str, Any]]] = {}
    for about in files.values():
        if "shape" in about:
            kinds.setdefault(_sensor_words(about), []).append(about)
    lines = [f"# {len(own)} files: {words}{_exposure_words(own)}" for words, own in kinds.items()]
    return [*lines, *(f"  {verdict}" for verdict in quality), *(f"  warning: {warning}" for warning in warnings_of(files))]


def _sensor_words(about: Mapping[str, Any]) -> str:
    rows, cols = about["shape"]
    return f"{rows} x {cols} px, {about['cfa']}, {about['bits']} bit, white {about['white_dn']:g} DN"


def _exposure_words(files: Sequence[Mapping[str, Any]]) -> str:
    def spread(name: str) -> list[float]:
        return sorted({about["exposure"][name] for about in files if about["exposure"].get(name)})

    def ends(values: Sequence[float]) -> str:
        return " to ".join(f"{v:.6g}" for v in dict.fromkeys((values[0], values[-1])))

    time_s, iso = spread("time_s"), spread("iso")
    return (f", {ends(time_s)} s" if time_s else "") + (f", ISO {ends(iso)}" if iso else "")


def _black_words(about: Mapping[str, Any]) -> str:
    provenance = about["provenance"]
    levels = ", ".join(f"{plane} {dn:.2f}" for plane, dn in about["black_dn"].items())
    words = f"{levels} DN, from {str(provenance.get('black_used', 'unknown')).replace('_', ' ')}"
    margin, tag = provenance.get("optical_black"), provenance.get("black_tag_dn")
    if margin is not None and tag is not None:
        mean_tag = sum(v for row in tag for v in row) / 4
        words += (
            f"; tag {mean_tag:g} DN, optical black of the hidden margin differs by "
            f"{with_sigma(margin['difference_dn'], margin['difference_sigma_dn'], 'DN')}"
        )
    elif tag is not None:
        words += "; the file has no hidden margin to check the tag against"
    return words


def _clipped_words(about: Mapping[str, Any]) -> str:
    parts = [f"{plane} {c['at_zero']} at 0 and {c['at_white']} at white" for plane, c in about["clipped"].items()]
    return "clipped pixels: " + "; ".join(parts)


def metric_lines(metrics: Sequence[Metric], *, files: Sequence[str], brief: bool) -> list[str]:
    """Tables of the metrics: patches by plane, then everything else."""
    patches = [m for m in metrics if m.name == "patch_mean" and m.patch]
    lines: list[str] = []
    if patches and not brief:
        lines += _patch_table(patches)
    told = ("patch_mean", "patch_noise")  # the table has the means; the noise of every patch stands in the JSON
    rest = [(m, f) for m, f in zip(metrics, files, strict=True) if not (m.name in told and m.patch) or brief]
    if len(rest) > MAX_ROWS:
        return [*lines, *_family_table([m for m, _ in rest])]
    if rest:
        lines.append("# metrics")
        body = [
            (
                m.name,
                m.channel,
                f"{m.region}{m.patch}",
                "" if m.frequency_cy_px is None else f"{m.frequency_cy_px:g} cy/px",
                with_sigma(m.value, m.sigma, m.unit),
                m.reason,
                PurePath(f).name if brief else "",
            )
            for m, f in rest
        ]
        lines += _dropping_empty(("metric", "channel", "where", "at", "value", "flags", "file"), body)
    return lines


def headline_lines(
    rows: Sequence[Mapping[str, Any]], files: Mapping[str, Mapping[str, Any]] | None = None, half_diagonal_mm: float = 0.0
) -> list[str]:
    """The numbers that people ask for first."""
    from isetval.app.headline import headline_tables

    lines: list[str] = []
    for title, table in headline_tables(rows, files=files, half_diagonal_mm=half_diagonal_mm):
        lines += [f"# {title}", *text_table(table[0], table[1:])]
    return lines


def counted_rejections(notes: Sequence[str]) -> list[str]:
    """Remarks, with the rejected edges of a file counted by reason where they are many."""
    found = [REJECTED.match(note) for note in notes]
    files = Counter(match["file"] for match in found if match)
    many = {file for file, count in files.items() if count > MAX_REJECTED}
    out: list[str] = []
    for note, match in zip(notes, found, strict=True):
        if match is None or match["file"] not in many:
            out.append(note)
        elif match["file"] in files:
            reasons = Counter(m["reason"].strip() for m in found if m and m["file"] == match["file"])
            words = ", ".join(f"{count} {reason}" for reason, count in reasons.most_common())
            out.append(f"{match['file']}{files.pop(match['file'])} of the rejected edges: {words} (all with -o page.html)")
    return out


def _family_table(metrics: Sequence[Metric]) -> list[str]:
    """How many numbers of each kind there are, where they are too many for a screen."""
    families: dict[str, list[Metric]] = {}
    for m in metrics:
        families.setdefault(m.family or m.name, []).append(m)
    body = [(name, len(rows), " ".join(dict.fromkeys(m.unit for m in rows))) for name, rows in families.items()]
    return [f"# {len(metrics)} metrics (all of them with --json or -o)", *text_table(("family", "n", "unit"), body)]


def _dropping_empty(header: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    keep = [i for i in range(len(header)) if any(row[i] for row in body)]
    return text_table([header[i] for i in keep], [[row[i] for i in keep] for row in body])


def _patch_table(patches: Sequence[Metric]) -> list[str]:
    planes = list(dict.fromkeys(m.channel for m in patches))
    names = list(dict.fromkeys(m.patch for m in patches))
    value = {(m.patch, m.channel): m for m in patches}
    body = [
        (i, name, *(with_sigma(value[name, p].value, value[name, p].sigma) if (name, p) in value else "" for p in planes))
        for i, name in enumerate(names, 1)
    ]
    return ["# patch means above black, DN +- sigma", *text_table(("", "patch", *planes), body)]
