"""Measuring loose files: one DNG after another, or a set of one role, without a campaign around them."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from isetval.core.capture import Capture, plane_black_dn, plane_view, planes_of
from isetval.core.errors import InputError
from isetval.core.metric import Metric

if TYPE_CHECKING:
    import pandas as pd

Reader = Callable[[Path], Capture]
Progress = Callable[[str, int, int], None]
CACHE_PIXELS = 400_000_000
RAW_SUFFIXES = (".dng",)


@dataclass(frozen=True, eq=False)
class FileMeasurement:
    """What loose files gave.

    ``metrics`` are (file name or "", Metric); ``files`` describes every file that was read; ``skipped``
    are (file, reason) of those that could not be read; ``notes`` are remarks with their reason.
    """

    metrics: tuple[tuple[str, Metric], ...] = ()
    files: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    skipped: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)


def raw_files(paths: Iterable[Path]) -> list[Path]:
    """The DNG files among files and folders, folders searched one level deep, in order of name.

    Raises
    ------
    InputError
        For a path that does not exist, or when there is no DNG at all.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = sorted(p for p in path.iterdir() if p.suffix.lower() in RAW_SUFFIXES and not p.name.startswith("."))
            if not inside:
                raise InputError(f"{path}: holds no DNG file; name the folder that holds them, or the files")
            found += inside
        elif path.exists():
            found.append(path)
        else:
            raise InputError(f"{path}: does not exist; check the path")
    return list(dict.fromkeys(found))


class FileSequence(Sequence[Capture]):
    """Captures of files, decoded on request; the last ones used stay in memory up to a limit."""

    def __init__(self, paths: Sequence[Path], read: Reader) -> None:
        self._paths, self._read = list(paths), read
        self._kept: OrderedDict[int, Capture] = OrderedDict()

    @overload
    def __getitem__(self, index: int) -> Capture: ...
    @overload
    def __getitem__(self, index: slice) -> list[Capture]: ...
    def __getitem__(self, index: int | slice) -> Capture | list[Capture]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        i = range(len(self))[index]
        if i not in self._kept:
            self._kept[i] = self._read(self._paths[i])
            while sum(c.mosaic.size for c in self._kept.values()) > CACHE_PIXELS and len(self._kept) > 1:
                self._kept.popitem(last=False)
        self._kept.move_to_end(i)
        return self._kept[i]

    def __len__(self) -> int:
        return len(self._paths)


def readable(
    paths: Sequence[Path], read: Reader, *, describe: bool = True, progress: Progress | None = None
) -> tuple[list[Path], dict[str, Mapping[str, Any]], list[tuple[str, str]]]:
    """Files that can be read with their description, and the others with the reason."""
    from isetval.files.dng import describe_capture

    good: list[Path] = []
    files: dict[str, Mapping[str, Any]] = {}
    skipped: list[tuple[str, str]] = []
    for i, path in enumerate(paths):
        try:
            capture = read(path)
        except InputError as error:
            skipped.append((str(path), _without_path(str(error), path)))
            continue
        finally:
            if progress is not None:
                progress(f"reading {path.name}", i + 1, len(paths))
        good.append(path)
        described = describe_capture(capture) if describe else {"provenance": dict(capture.provenance)}
        files[str(path)] = described | {"sha256": capture.provenance.get("sha256", "")}
    return good, files, skipped


def _without_path(message: str, path: Path) -> str:
    return message.removeprefix(f"{path}: ").removeprefix(f"{path.name}: ")


def measure_files(
    paths: Sequence[Path], *, read: Reader, role: str | None = None, progress: Progress | None = None
) -> FileMeasurement:
    """Measure loose files; those that cannot be read are listed with their reason.

    Parameters
    ----------
    paths : sequence of Path
    read : callable
        Path -> Capture.
    role : str, optional
        ``dark`` and ``flat``: the files together are one series; ``edge``, ``chart``, ``scene``: each
        file on its own.  Without a role each file is searched for a chart, then for edges.
    progress : callable, optional

    Raises
    ------
    InputError
        If no file can be read.
    """
    if role in ("dark", "flat"):
        return _series(paths, read, role, progress)
    metrics: list[tuple[str, Metric]] = []
    files: dict[str, Mapping[str, Any]] = {}
    skipped: list[tuple[str, str]] = []
    notes: list[str] = []
    for i, path in enumerate(paths):
        good, described, bad = readable([path], read)
        skipped += bad
        files |= described
        if good:
            rows, remarks = measure_one(read(path), role=role)
            metrics += [(str(path), row) for row in rows]
            notes += [f"{path.name}: {remark}" for remark in remarks]
        if progress is not None:
            progress(f"measuring {path.name}", i + 1, len(paths))
    return _checked(FileMeasurement(tuple(metrics), files, tuple(skipped), tuple(notes), {"role": role}))


def _checked(result: FileMeasurement) -> FileMeasurement:
    if not result.files:
        path, reason = result.skipped[0]
        more = f" ({len(result.skipped)} files, all refused)" if len(result.skipped) > 1 else ""
        raise InputError(f"{path}: {reason}{more}")
    return result


def measure_one(capture: Capture, *, role: str | None = None) -> tuple[list[Metric], list[str]]:
    """Metrics of a single capture and remarks: its quality, its chart, else its edges, and the statistics of every plane."""
    notes = [quality_note(capture)]
    rows = plane_rows(capture)
    looks = {"chart": (chart_rows,), "edge": (edge_rows,), "scene": (patch_rows,), None: (chart_rows, edge_rows)}[role]
    for look in looks:
        try:
            found, remarks = look(capture)
        except InputError as error:
            notes.append(str(error))
            continue
        notes += remarks
        if found:
            return rows + found, notes
    return rows, notes


def quality_note(capture: Capture) -> str:
    """Verdict on the capture with its reasons, before any number."""
    from isetval.measure import quality

    try:
        found = quality(capture)
    except InputError as error:
        return f"capture quality not judged: {error}"
    return f"capture quality: {found.verdict}" + (f" ({', '.join(found.reasons)})" if found.reasons else "")


def plane_rows(capture: Capture) -> list[Metric]:
    """Mean above black and standard deviation of all pixels of each plane (a picture's content included)."""
    rows = []
    for plane in planes_of(capture):
        view = plane_view(capture, plane)[0]
        n, std = view.size, float(view.std(ddof=1, dtype=np.float64)) if view.size > 1 else float("nan")
        mean = float(view.mean(dtype=np.float64)) - plane_black_dn(capture, plane)
        rows.append(_row("plane_mean", mean, std / np.sqrt(n), "DN", channel=plane, family="plane"))
        if n > 1:
            rows.append(_row("plane_std", std, std / np.sqrt(2 * (n - 1)), "DN", channel=plane, family="plane"))
    return rows


def _row(name: str, value: float, sigma: float, unit: str, **more: Any) -> Metric:
    return Metric(name=name, value=float(value), sigma=float(sigma), unit=unit, **more)


def chart_rows(capture: Capture) -> tuple[list[Metric], list[str]]:
    """Patch means of a chart that is looked for, noise of each patch, and the mean-variance line of each plane."""
    from isetval.measure import chart

    result = chart(capture)
    rows = []
    for entry in result.rows():
        place = {"channel": entry["plane"], "patch": entry["patch"], "family": "chart"}
        rows.append(_row("patch_mean", entry["mean_dn"], entry["sigma_dn"], "DN", **place))
    for plane, line in result.noise_lines.items():
        slope = _row("mean_variance_slope", line.slope_dn, line.slope_sigma_dn, "DN", channel=plane, family="chart_noise")
        offset = _row(
            "mean_variance_intercept", line.intercept_dn2, line.intercept_sigma_dn2, "DN^2", channel=plane, family="chart_noise"
        )
        rows += [slope, offset]
    words = f"chart found ({result.found_by}), its colours agree {result.confidence:.2f}"
    clipped, bad = int(result.patches.clipped_pixels.sum()), int(result.patches.bad_pixels.sum())
    words += f"; in the patches {clipped} clipped and {bad} bad pixels were left out" if bad else f"; {clipped} clipped pixels"
    return rows, [words, *result.warnings]


def edge_rows(capture: Capture) -> tuple[list[Metric], list[str]]:
    """MTF50 and angle of every slanted edge that is found, for each channel; rejected regions with their reason."""
    from isetval.measure import find_edges, sfr_batch

    found = find_edges(capture)
    rows: list[Metric] = []
    notes = [f"{len(found)} edges accepted, {len(found.rejected)} rejected"]
    channels = ("R", "G", "B") if capture.sensor.cfa != "MONO" else ("G",)
    results = {channel: sfr_batch(capture, [tuple(edge) for edge in found], channel) for channel in channels}
    for number, edge in enumerate(found):
        label = ",".join(map(str, edge))
        for channel in channels:
            result = results[channel][number]
            if not result.accepted:
                notes.append(f"edge at {label}, channel {channel}: {', '.join(result.flags)}")
                continue
            place = {"channel": channel, "region": label, "family": "edge", "orientation": result.orientation}
            rows.append(_row("mtf50", result.mtf50_cy_px, result.mtf50_sigma, "cy/px", **place))
            sigma = float(np.interp(0.25, result.frequency_cy_px, result.mtf_sigma))
            value = float(np.interp(0.25, result.frequency_cy_px, result.mtf))
            rows.append(_row("mtf", value, sigma, "1", frequency_cy_px=0.25, **place))
    notes += [f"edge rejected at {_place(r)}: {_reason(r)}" for r in found.rejected[:20]]
    return rows, notes


def _place(rejected: Any) -> str:
    roi = getattr(rejected, "roi", None)
    return ",".join(map(str, roi if roi is not None else tuple(rejected)[:4]))


def _reason(rejected: Any) -> str:
    return str(getattr(rejected, "reason", getattr(rejected, "reasons", "")))


def patch_rows(capture: Capture) -> tuple[list[Metric], list[str]]:
    """Level and spatial noise of uniform regions."""
    from isetval.measure import uniform_patches

    table = uniform_patches(capture)
    rows = []
    for p in table.accepted:
        place = {"channel": p.channel, "region": ",".join(map(str, p.region)), "family": "uniform_patch"}
        rows.append(_row("patch_mean", p.mean_dn, p.mean_sigma_dn, "DN", **place))
        rows.append(_row("patch_spatial_std", p.spatial_std_dn, p.sigma_dn, "DN", **place))
    return rows, [f"{len(table.accepted)} of {len(table)} regions are uniform"]


def _series(paths: Sequence[Path], read: Reader, role: str, progress: Progress | None) -> FileMeasurement:
    """Darks or flats: one series, grouped by size."""
    good, files, skipped = readable(paths, read, describe=len(paths) <= 64, progress=progress)
    result = FileMeasurement((), files, tuple(skipped), (), {"role": role})
    _checked(result)
    by_size: dict[tuple[int, ...], list[Path]] = {}
    for path in good:
        by_size.setdefault(tuple(files[str(path)].get("shape", ())), []).append(path)
    metrics: list[tuple[str, Metric]] = []
    notes: list[str] = []
    for group in by_size.values():
        rows, remarks = series_rows(FileSequence(group, read), role)
        metrics += [("", row) for row in rows]
        notes += remarks
    return replace(result, metrics=tuple(metrics), notes=tuple(notes))


def series_rows(captures: Sequence[Capture], role: str) -> tuple[list[Metric], list[str]]:
    """Dark signal of darks; photon transfer and relative illumination of flats."""
    from isetval.measure import dark, photon_transfer, relative_illumination

    rows: list[Metric] = []
    notes: list[str] = []
    analyses: tuple[Callable[[], Iterator[Metric]], ...] = (
        (lambda: frame_rows(dark(captures).to_frame(), "dark"),)
        if role == "dark"
        else (
            lambda: frame_rows(photon_transfer(captures).to_frame(), "photon_transfer"),
            lambda: falloff_rows(relative_illumination(captures)),
        )
    )
    for analysis in analyses:
        try:
            rows += list(analysis())
        except InputError as error:
            notes.append(str(error))
    return rows, notes


def frame_rows(frame: pd.DataFrame, family: str) -> Iterator[Metric]:
    """Rows of a table with plane, name, value, sigma, unit, flags."""
    for row in frame.to_dict("records"):
        value, sigma = float(row["value"]), float(row["sigma"])
        if np.isfinite(value):
            place = {"channel": str(row["plane"]), "family": family, "reason": str(row["flags"])}
            yield _row(str(row["name"]), value, sigma, str(row["unit"]), **place)


def falloff_rows(result: Any) -> Iterator[Metric]:
    """Relative illumination over radius for every plane, at eleven radii."""
    for plane, falloff in result.planes.items():
        at = np.linspace(0, len(falloff.radius_mm) - 1, 11).round().astype(int)
        for i in at:
            yield _row(
                "relative_illumination",
                falloff.curve[i],
                falloff.sigma[i],
                "1",
                channel=plane,
                family="relative_illumination",
                field_x_mm=float(falloff.radius_mm[i]),
                field_y_mm=0.0,
                region=f"r={falloff.radius_mm[i]:.3f} mm",
            )


def file_reader(*, black: str = "auto", raw: Mapping[str, Any] | None = None) -> Reader:
    """How files are read: DNG by their tags, headerless raw by what the person says."""
    from isetval.files.dng import read_dng, read_raw

    def read(path: Path) -> Capture:
        capture: Capture
        if raw is not None and path.suffix.lower() not in RAW_SUFFIXES:
            capture = read_raw(path, **raw)
            return capture
        if path.is_dir():
            raise InputError(f"{path}: is a folder; name files")
        capture = read_dng(os.fspath(path), black=black)
        return capture

    return read
