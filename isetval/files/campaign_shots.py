"""The ``[[shot]]`` tables of a campaign: names, repeats, files, windows, and the metrics that somebody else measured."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from isetval.core.campaign import Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.given import GivenMetrics
from isetval.core.scene import Target
from isetval.core.sensor import Exposure, Sensor, Window
from isetval.core.toml import check_keys, inside, number, numbers, text, texts
from isetval.files.metric_file import Reading, read_metrics

MOST_FRAMES = 100_000  # of a shot: a typing error of more would be simulated for years
METRIC_KEYS = ("metric", "column", "sigma", "edge", "correlation_length", "covariance")
"""Keys of a shot that say how its metrics file is read, beside method and channel."""
SHOT_KEYS = (
    "name", "role", "measurement_session", "setup", "light", "light_level", "exposure_s", "iso", "rotation_deg", "window",
    "size", "frames", "files", "target", "focus_um", "focus_m", "distance_m", "repeat_of", "method", "channel",
    "photons_per_pixel", "levels_only", "notes", "metrics", *METRIC_KEYS,
)  # fmt: skip


def read_shots(
    entries: Sequence[Any], targets: Mapping[str, Target], path: Path, *, files_needed: bool = True
) -> tuple[Shot, ...]:
    """The shots of ``path``, each with a name of its own; windows may be open and metrics unread.

    Of a plan that is simulated only, the captures are not ``files_needed``.

    Raises
    ------
    InputError
        For unknown keys, missing files, unknown targets, or values that make no sense, with the shot's number.
    """
    shots = tuple(_shot(entry, f"{path}: [[shot]] number {i}", targets, path, files_needed) for i, entry in enumerate(entries, 1))
    return _found_repeats(_told_apart(shots, entries))


def _shot(entry: Any, where: str, targets: Mapping[str, Target], path: Path, files_needed: bool) -> Shot:
    entry = check_keys(entry, where, known=SHOT_KEYS, needed=("role",))
    files = texts(entry, "files", where)
    for file in files:
        if not inside(path.parent, file).is_file() and files_needed:
            raise InputError(f"{where}: names {file}, which is not in {path.parent}; correct the name or put the file there")
    if orphan := [key for key in METRIC_KEYS if key in entry and "metrics" not in entry]:
        raise InputError(f'{where}: {orphan[0]} says how a metrics file is read, and there is none; add metrics = "file.csv"')
    target = text(entry, "target", where)
    if target and target not in targets:
        raise InputError(f"{where}: target {target!r} is not described; the file has: {', '.join(targets) or 'none'}")
    frames = entry.get("frames", max(1, len(files)))
    if not isinstance(frames, int) or isinstance(frames, bool) or not 1 <= frames <= MOST_FRAMES:
        raise InputError(f"{where}: frames is {frames!r}; a shot has 1 to {MOST_FRAMES} frames")
    if files and frames != len(files):
        raise InputError(f"{where}: frames is {frames!r} and it names {len(files)} files; they must agree")
    name = text(entry, "name", where) or text(entry, "setup", where) or text(entry, "role", where)
    try:
        return Shot(
            name=name,
            role=text(entry, "role", where),
            setup=text(entry, "setup", where) or name,
            measurement_session=text(entry, "measurement_session", where, "A"),
            exposure=Exposure(
                _optional(entry, "exposure_s", where), _optional(entry, "iso", where), focus_m=_distance(entry, "focus_m", where)
            ),
            frames=frames,
            light=text(entry, "light", where) or None,
            light_level=number(entry, "light_level", where, 1.0),
            rotation_deg=number(entry, "rotation_deg", where, 0.0),
            window=_window(entry, where),
            target=targets[target] if target else None,
            focus_um=number(entry, "focus_um", where, 0.0),
            distance_m=_distance(entry, "distance_m", where),
            repeat_of=text(entry, "repeat_of", where) or None,
            files=files,
            method="" if "metrics" in entry else text(entry, "method", where),
            channel="" if "metrics" in entry else text(entry, "channel", where),
            photons_per_pixel=_optional(entry, "photons_per_pixel", where),
            levels_only=_yes_or_no(entry, "levels_only", where),
        )
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(where) else f"{where}: {error}") from None


def _yes_or_no(entry: Mapping[str, Any], key: str, where: str) -> bool:
    value = entry.get(key, False)
    if not isinstance(value, bool):
        raise InputError(f"{where}: {key} is {value!r}; it needs true or false")
    return value


def read_given(entry: Mapping[str, Any], where: str, sensor: Sensor, path: Path) -> GivenMetrics:
    """The metrics that a shot's file states."""
    edge = entry.get("edge")
    if edge is not None and (not isinstance(edge, int) or isinstance(edge, bool)):
        raise InputError(f"{where}: edge is {edge!r}; it needs a whole number from 1")
    how = Reading(
        metric=text(entry, "metric", where),
        column=text(entry, "column", where),
        sigma=_optional(entry, "sigma", where),
        channel=text(entry, "channel", where),
        edge=edge,
        method=text(entry, "method", where),
        correlation_length=number(entry, "correlation_length", where, 0.0),
        covariance=text(entry, "covariance", where),
    )
    try:
        return read_metrics(path.parent, text(entry, "metrics", where), sensor, how)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _told_apart(shots: tuple[Shot, ...], entries: Sequence[Mapping[str, Any]]) -> tuple[Shot, ...]:
    """Shots that the file gives no name are called by their set-up, numbered where that is not enough."""
    given = {shot.name for shot, entry in zip(shots, entries, strict=True) if "name" in entry}
    counts = Counter(shot.name for shot in shots)
    out = []
    for place, (shot, entry) in enumerate(zip(shots, entries, strict=True), 1):
        alone = counts[shot.name] == 1 and shot.name not in given
        own = shot if "name" in entry or alone else replace(shot, name=f"{shot.name}_{place}")
        out.append(own if "setup" in entry else replace(own, setup=own.name))  # nothing said: a set-up of its own
    return tuple(out)


def _found_repeats(shots: tuple[Shot, ...]) -> tuple[Shot, ...]:
    """``repeat_of`` may name a shot or a set-up: of a set-up, the shot of the same role, exposure, window and light level."""
    names = {shot.name for shot in shots}

    def twin(shot: Shot) -> str | None:
        if shot.repeat_of is None or shot.repeat_of in names:
            return shot.repeat_of
        same = (shot.role, shot.exposure, shot.window, shot.light_level, shot.focus_um)
        for other in shots:
            if (
                other.setup == shot.repeat_of
                and (other.role, other.exposure, other.window, other.light_level, other.focus_um) == same
            ):
                return other.name
        return shot.repeat_of

    return tuple(replace(shot, repeat_of=twin(shot)) for shot in shots)


def _distance(entry: Mapping[str, Any], key: str, where: str) -> float | None:
    """A distance in metres; ``inf`` is far away."""
    value = _optional(entry, key, where)
    if value is not None and not value > 0:
        raise InputError(f"{where}: {key} is {value:g}; it needs a distance in metres above 0, or inf")
    return value


def _optional(entry: Mapping[str, Any], key: str, where: str) -> float | None:
    return number(entry, key, where) if key in entry else None


def _window(entry: Mapping[str, Any], where: str) -> Window | None:
    if "window" not in entry and "size" not in entry:
        return None
    window = numbers(entry, "window", where, lengths=(2, 4)) if "window" in entry else (0.0, 0.0)
    size = numbers(entry, "size", where, lengths=(2,)) if "size" in entry else window[2:] or (0.0, 0.0)
    return Window.of([int(v) for v in (*window[:2], *size)])


def sized(shot: Shot, sensor: Sensor, path: Path) -> Shot:
    """The shot with a full window: from the plan, else from its first file, else the whole sensor."""
    window = shot.window
    if window is not None and window[2] > 0:
        pass
    elif shot.files:
        if not any((path.parent / file).is_file() for file in shot.files):
            raise InputError(
                f"shot {shot.name}: its window is that of its files, which are not in {path.parent}; add "
                "window = [row0, col0, rows, cols], or put them there"
            )
        first = first_readable(shot.files, path)
        window = Window(*(window[:2] if window else first.window), *first.mosaic.shape)
    elif window is None:
        window = Window(0, 0, sensor.rows, sensor.cols)
    else:
        raise InputError(
            f"shot {shot.name}: window {list(window[:2])} has no size and there are no files to take it from; add size"
        )
    if not window.fits((sensor.rows, sensor.cols)):
        raise InputError(f"shot {shot.name}: window {list(window)} leaves the sensor of {sensor.rows} x {sensor.cols} pixels")
    return replace(shot, window=window)


def first_readable(files: Sequence[str], path: Path) -> Capture:
    """The first capture that can be read: one broken frame does not lose the others.

    Raises
    ------
    InputError
        The first file's reason, if none can be read.
    """
    from isetval.files.capture_file import read_capture

    reasons = []
    for file in files:
        try:
            capture: Capture = read_capture(path.parent / file)
        except InputError as error:
            reasons.append(error)
        else:
            return capture
    raise reasons[0]
