"""Loose files without a campaign around them: they become one, and are measured like every other."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from isetval.core.campaign import Campaign, Shot
from isetval.core.capture import Capture, check_roi
from isetval.core.captures import MemoryCaptures
from isetval.core.errors import InputError
from isetval.core.metric import Metric, MetricTable
from isetval.core.paths import common_folder, seen_from
from isetval.core.sensor import RoiLike, Window
from isetval.files.captures import FileCaptures
from isetval.files.file_facts import FileFacts, by_level, facts_of
from isetval.files.raw_files import files_below, nothing_in
from isetval.files.target_search import find_targets
from isetval.measure.campaign import measure_campaign
from isetval.measure.shot_summaries import plane_levels

Reader = Callable[[Path], Capture]
Progress = Callable[[str, int, int], None]
DESCRIBED = 64  # files of a series that are described pixel by pixel; of longer ones only what the tags say
SERIES_ROLES = ("dark", "flat")


@dataclass(frozen=True)
class Asked:
    """What a person asks of the estimators: a method, one channel, a region, a stated gain, darks of the flats."""

    role: str | None = None
    method: str = ""
    channel: str = ""
    roi: RoiLike | None = None
    gain_dn_per_e: float | None = None
    darks: tuple[Path, ...] = ()

    @property
    def patches(self) -> Mapping[str, Any]:
        """Arguments of `uniform_patches`."""
        return {} if self.gain_dn_per_e is None else {"gain_dn_per_e": self.gain_dn_per_e}


@dataclass(frozen=True, eq=False)
class FileMeasurement:
    """What loose files gave.

    ``metrics`` are (file name, or "" where several files gave it, Metric); ``files`` describes every file that was read;
    ``skipped`` are (file, reason) of those that could not be read; ``notes`` are remarks with their reason; ``empty`` says
    that the role asked for gave no number, with the reasons; ``campaign`` is what a series of darks or flats became.
    """

    metrics: tuple[tuple[str, Metric], ...] = ()
    files: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    skipped: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    empty: str = ""
    campaign: Campaign | None = None


def levels_are_said(raw: Mapping[str, Any] | None) -> bool:
    """Whether a command says what sidecars of pictures say (a shape is said of headerless raw)."""
    return raw is not None and "shape" not in raw


def raw_files(paths: Iterable[Path], *, said: bool = False) -> list[Path]:
    """The files to measure among files and folders, folders searched at all levels, in order of name.

    ``said``: levels of pictures (TIFF, PNG, NPY) are said with the command, so that they need no sidecar.

    Raises
    ------
    InputError
        For a path that does not exist, or a folder that holds no raw file at all.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = files_below(path, said=said)
            if not inside:
                raise InputError(nothing_in(path))
            found += inside
        elif path.exists():
            found.append(path)
        else:
            raise InputError(f"{path}: does not exist; check the path")
    return list(dict.fromkeys(found))


def measure_files(
    paths: Sequence[Path], *, read: Reader, role: str | None = None, asked: Asked | None = None, progress: Progress | None = None
) -> FileMeasurement:
    """Measure loose files as the shots of a campaign; those that cannot be read are listed with their reason.

    Parameters
    ----------
    paths : sequence of Path
    read : callable
        Path -> Capture.
    role : str, optional
        ``dark`` and ``flat``: files of one folder, sensor and ISO are a series, those of one exposure and level one
        shot; ``edge``, ``chart``, ``disk``, ``scene``: each file is a shot, its target is searched in it.  Without a role each
        file is searched for a chart, then for edges.
    asked : Asked, optional
        Role and options of the estimators.
    progress : callable, optional

    Raises
    ------
    InputError
        If no file can be read.
    """
    asked = asked or Asked(role)
    result = try_files(paths, read=read, asked=asked, progress=progress)
    if not result.files:
        path, reason = result.skipped[0]
        more = f" ({len(result.skipped)} files, all refused)" if len(result.skipped) > 1 else ""
        raise InputError(f"{path}: {reason}{more}")
    return result


def try_files(paths: Sequence[Path], *, read: Reader, asked: Asked, progress: Progress | None = None) -> FileMeasurement:
    """As `measure_files`, with all files in ``skipped`` where none can be read."""
    captures = FileCaptures(
        {"": [str(path) for path in (*paths, *asked.darks)]}, lambda _, file: _cropped(read(Path(file)), asked)
    )
    measure = _series if asked.role in SERIES_ROLES else _one_by_one
    result = measure(paths, captures, asked, progress)
    if result.files and asked.role is not None and not any(m.family != "plane" for _, m in result.metrics):
        reasons = "; ".join([note for note in result.notes if ": capture quality" not in note][:3]) or "no reason was given"
        return replace(result, empty=f"role {asked.role} gave no number: {reasons}")
    return result


def _cropped(capture: Capture, asked: Asked) -> Capture:
    """The region asked for as a capture of its own, at its place on the sensor; an edge keeps its surroundings."""
    if asked.roi is None or asked.role in ("edge", "disk"):
        return capture
    row0, row1, col0, col1 = check_roi(capture, asked.roi)
    corner = (capture.window[0] + row0, capture.window[1] + col0)
    return replace(capture, mosaic=capture.mosaic[row0:row1, col0:col1], window=corner)


def _settings(asked: Asked) -> dict[str, Any]:
    more: dict[str, Any] = {
        "method": asked.method,
        "channel": asked.channel,
        "roi": asked.roi,
        "gain_dn_per_e": asked.gain_dn_per_e,
    }
    more["darks"] = [str(path) for path in asked.darks]
    return {"role": asked.role} | {name: value for name, value in more.items() if value}


def _described(capture: Capture, *, briefly: bool) -> dict[str, Any]:
    from isetval.files.dng import describe_capture

    about = {"provenance": dict(capture.provenance)} if briefly else describe_capture(capture)
    return about | {"sha256": capture.provenance.get("sha256", "")}


def _one_by_one(paths: Sequence[Path], captures: FileCaptures, asked: Asked, progress: Progress | None) -> FileMeasurement:
    """Edges, charts, scenes, and files of which nothing is known: each a small campaign."""
    metrics: list[tuple[str, Metric]] = []
    files: dict[str, Mapping[str, Any]] = {}
    notes: list[str] = []
    for i, path in enumerate(paths):
        capture = captures.take("", str(path))
        if capture is not None:
            try:
                files[str(path)] = _described(capture, briefly=False)
                rows, remarks = measure_one(capture, path.name, asked)
            except Exception as error:  # one odd file must not lose the others
                captures.refuse(str(path), error)
                files.pop(str(path), None)
            else:
                metrics += [(str(path), row) for row in rows]
                notes += [f"{path.name}: {remark}" for remark in remarks]
        if progress is not None:
            progress(f"measuring {path.name}", i + 1, len(paths))
    return FileMeasurement(tuple(metrics), files, tuple(captures.skipped), tuple(notes), _settings(asked))


def measure_one(capture: Capture, name: str, asked: Asked | None = None) -> tuple[list[Metric], list[str]]:
    """Metrics of one capture and remarks: its quality, the levels of its planes, and what is found in it."""
    asked = asked or Asked()
    notes = [quality_note(capture)]
    found = find_targets(capture, asked.role, roi=asked.roi, channel=asked.channel)
    notes += found.notes
    whole = Shot(name, "flat", window=Window(*capture.window, *capture.mosaic.shape))  # its role is not known
    rows = [replace(m, role=asked.role or "") for m in plane_levels(whole, [capture]).metrics]
    shots = []
    for target in found.targets:
        role = "edge" if target.name.startswith("edge") else (asked.role or "chart").replace("disk", "chart")
        label = name if len(found.targets) == 1 else f"{name} {target.name}"
        shots.append(replace(whole, name=label, setup=label, role=role, target=target, **_options(asked)))
    if shots:
        campaign = Campaign(name, tuple(shots), MemoryCaptures({shot.name: (capture,) for shot in shots}))
        try:
            table = measure_campaign(campaign, patches=asked.patches)
        except InputError as error:
            return rows, [*notes, str(error)]
        rows += [_placed(m, shots) for m in _rows(table) if m.family != "plane"]
        notes += table.notes
    return rows, notes


def _options(asked: Asked) -> dict[str, Any]:
    return {"method": asked.method, "channel": asked.channel}


def _rows(table: MetricTable) -> list[Metric]:
    """The rows with their whole sigma, shared parts included."""
    return [replace(m, sigma=float(sigma)) for m, sigma in zip(table.metrics, table.sigma, strict=True)]


def _placed(row: Metric, shots: Sequence[Shot]) -> Metric:
    """A row of an edge says where in the capture it lies."""
    roi = next((getattr(s.target, "roi", None) for s in shots if s.name == row.shot), None)
    return row if row.region or roi is None else replace(row, region=",".join(map(str, roi)))


def quality_note(capture: Capture, *, cut: bool = False) -> str:
    """Verdict on the capture with its reasons, before any number; the border of a window that was ``cut`` out is the scene's."""
    from isetval.measure import quality

    try:
        found = quality(capture)
    except InputError as error:
        return f"capture quality not judged: {error}"
    reasons = [reason for reason in found.reasons if not (cut and reason == "bad_border")]
    verdict = found.verdict if reasons else "good"
    return f"capture quality: {verdict}" + (f" ({', '.join(reasons)})" if reasons else "")


def _series(paths: Sequence[Path], captures: FileCaptures, asked: Asked, progress: Progress | None) -> FileMeasurement:
    """Darks or flats: one campaign, in which each folder, sensor and ISO is a session, which the darks asked for join."""
    files: dict[str, Mapping[str, Any]] = {}
    facts: list[FileFacts] = []
    verdicts: list[str] = []
    paths = [*paths, *asked.darks]
    for i, path in enumerate(paths):
        capture = captures.look_ahead("", str(path))
        if capture is not None:
            try:
                files[str(path)] = _described(capture, briefly=len(paths) > DESCRIBED)
                verdicts += [f"{path.name}: {quality_note(capture)}"] if len(paths) <= DESCRIBED else []
                facts.append(facts_of(str(path), str(path.parent), capture))
            except Exception as error:  # one odd file must not lose the others
                captures.refuse(str(path), error)
                files.pop(str(path), None)
        if progress is not None:
            progress(f"reading {path.name}", i + 1, len(paths))
    nothing = FileMeasurement((), files, tuple(captures.skipped), (), _settings(asked))
    if not facts:
        return nothing
    shots = series_shots(facts, asked)
    campaign = Campaign("loose files", shots, captures.grouped({shot.name: shot.files for shot in shots}))
    try:
        table = measure_campaign(campaign, patches=asked.patches)
    except InputError as error:
        return replace(nothing, skipped=tuple(captures.skipped), notes=(*verdicts, str(error)))
    lone = {shot.name: shot.files[0] for shot in shots if len(shot.files) == 1}
    metrics = tuple((lone.get(m.shot, ""), m) for m in _rows(table))
    notes = (*verdicts, *(note for note in table.notes if not note.startswith("file ")))
    return replace(nothing, metrics=metrics, skipped=tuple(captures.skipped), notes=notes, campaign=campaign)


def series_shots(facts: Sequence[FileFacts], asked: Asked) -> tuple[Shot, ...]:
    """Shots of loose darks or flats: files of one folder, sensor, ISO, window, exposure and level are frames of one."""
    role = asked.role or "flat"
    asked_for = set(map(str, asked.darks))
    darks = [fact for fact in facts if fact.file in asked_for]
    facts = [fact for fact in facts if fact.file not in asked_for]
    sessions: dict[Any, list[FileFacts]] = {}
    for fact in facts:
        sessions.setdefault((fact.folder, fact.scale), []).append(fact)
    common = common_folder([fact.folder for fact in facts])
    shots: list[Shot] = []
    for number, ((folder, scale), series) in enumerate(sessions.items(), 1):
        sensor, iso = scale
        label = f"{seen_from(folder, common)}, ISO {iso}, {sensor.rows} x {sensor.cols}" if len(sessions) > 1 else "A"
        own = Shot("", role, setup=f"series {number}", measurement_session=label, **_options(asked))
        shots += _shots_like(own, series, len(shots))
        dark = replace(own, role="dark", setup=f"darks of series {number}")
        shots += _shots_like(dark, [fact for fact in darks if fact.scale == scale], len(shots))
    return tuple(shots)


def _shots_like(own: Shot, series: Sequence[FileFacts], before: int) -> list[Shot]:
    """Shots of a series by window, exposure and level, with the role and session of one of them, numbered on."""
    exposures: dict[Any, list[FileFacts]] = {}
    for fact in series:
        exposures.setdefault((fact.window, fact.exposure.time_s), []).append(fact)
    groups = [(window, group) for (window, _), same in exposures.items() for group in by_level(same)]
    return [
        replace(
            own,
            name=f"{own.role}_{number:02d}",
            exposure=group[0].exposure,
            frames=len(group),
            window=window,
            files=tuple(f.file for f in group),
        )
        for number, (window, group) in enumerate(groups, before + 1)
    ]


def file_reader(*, black: str = "auto", raw: Mapping[str, Any] | None = None, channel: str = "") -> Reader:
    """How files are read: DNG by their tags, pictures by their sidecars, headerless raw by what the person says.

    ``raw`` are the keywords of `isetval.files.headerless_file.read_raw`; without ``shape`` they are said of pictures in the
    place of a sidecar.  ``channel`` is the one of a demosaiced picture; a mosaic is read whole.  Files of one sensor share
    the black level of the first.
    """
    from isetval.files.capture_file import read_capture
    from isetval.files.dng.sensor_window import OneBlack
    from isetval.files.headerless_file import read_raw

    shared = OneBlack()

    def read(path: Path) -> Capture:
        if raw is not None and "shape" in raw and path.suffix.lower() != ".dng":
            return read_raw(path, **raw)
        if path.is_dir():
            raise InputError(f"{path}: is a folder; name files")
        sidecar = raw if path.suffix.lower() != ".dng" else None
        return shared(read_capture(path, black=black, sidecar=sidecar, channel=channel or None))  # type: ignore[arg-type]

    return read
