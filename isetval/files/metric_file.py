"""Files of metrics that somebody else measured: found out by their content, read, and given a covariance."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError
from isetval.core.given import GivenMetrics, axis_of
from isetval.core.metric import Block, Metric
from isetval.core.sensor import Sensor
from isetval.core.toml import inside
from isetval.files import curve_file, emva_datasheet, imatest_file, mtf_mapper_file, sfrmat_file
from isetval.files.given_rows import GivenTable, numbers, read_text, table_lines, to_metric

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Reading:
    """What a person says of a file that it may not say itself.

    ``metric`` names a curve of two columns (``column`` its values among several); ``sigma`` holds for rows without one;
    ``channel`` picks rows (or names those without); ``edge`` an edge or region of several; ``method`` replaces the one that the
    file's tool computes by.  ``correlation_length`` is in the unit of the axis (mm, cy/px, DN): neighbouring rows correlate with
    exp(-distance/length).  ``covariance`` names a file of the rows' whole covariance instead.
    """

    metric: str = ""
    column: str = ""
    sigma: float | None = None
    channel: str = ""
    edge: int | None = None
    method: str = ""
    correlation_length: float = 0.0
    covariance: str = ""


def read_metrics(folder: Path, name: str, sensor: Sensor, how: Reading) -> GivenMetrics:
    """The rows of a file below ``folder`` with their covariance.

    Raises
    ------
    InputError
        For a file that leads out of the folder, is not understood, or states no sigma.
    """
    path = inside(folder, name)
    where = str(path)
    table = _table(read_text(path), path, how)
    rows = tuple(row for row in table.rows if not how.channel or row.channel in ("", how.channel))
    if not rows:
        held = ", ".join(sorted({row.channel for row in table.rows})) or "no row"
        raise InputError(f"{where}: has no row of channel {how.channel!r}; it has {held}")
    metrics = tuple(to_metric(row, sensor, sigma=_sigma(how), where=where) for row in rows)
    if how.channel:
        metrics = tuple(_of_channel(m, how.channel) for m in metrics)
    files = (name, how.covariance) if how.covariance else (name,)
    try:
        block = _with_covariance(metrics, folder, how, where)
        return GivenMetrics(block, how.method or table.method, files, table.source)
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(str(folder)) else f"{where}: {error}") from None


def _sigma(how: Reading) -> float | None:
    return 1.0 if how.covariance and how.sigma is None else how.sigma  # replaced by the covariance's own


def _of_channel(row: Metric, channel: str) -> Metric:
    from dataclasses import replace

    return replace(row, channel=channel)


def _table(text: str, path: Path, how: Reading) -> GivenTable:
    where = str(path)
    if emva_datasheet.recognises(text):
        return emva_datasheet.read(text, where)
    if sfrmat_file.recognises(text):
        return sfrmat_file.read(text, where)
    if mtf_mapper_file.recognises(text, path.name):
        return mtf_mapper_file.read(text, where, edge=how.edge)
    if imatest_file.recognises(text):
        return imatest_file.read(text, where, edge=how.edge)
    if curve_file.is_table(text):
        return curve_file.read_table(text, where)
    if how.metric:
        return curve_file.read_curve(text, where, name=how.metric, column=how.column)
    raise InputError(
        f"{where}: is no file that is known (a table with the columns name, value, sigma; sfrmat; MTF Mapper; Imatest; EMVA "
        '1288); for a curve of two columns say what it is (metric = "relative_illumination", --as)'
    )


def _with_covariance(metrics: tuple[Metric, ...], folder: Path, how: Reading, where: str) -> Block:
    if how.covariance and how.correlation_length:
        raise InputError(f"{where}: has a covariance file and a correlation length; one of them says how rows correlate")
    if how.covariance:
        return _stated(metrics, inside(folder, how.covariance))
    if not how.correlation_length:
        return Block(metrics)
    if how.correlation_length < 0:
        raise InputError(f"{where}: correlation_length is {how.correlation_length:g}; it needs a length above 0")
    return Block(metrics, _along_axis(metrics, how.correlation_length))


def _along_axis(metrics: tuple[Metric, ...], length: float) -> Float:
    """exp(-distance/length) between rows of one curve (name and channel), (n, n)."""
    axis = np.array([np.nan if (at := axis_of(m)) is None else at for m in metrics])
    curve = np.array([f"{m.name} {m.channel} {m.patch}" for m in metrics])
    distance = np.abs(axis[:, None] - axis[None, :])
    out = np.where(curve[:, None] == curve[None, :], np.exp(-np.nan_to_num(distance, nan=np.inf) / length), 0.0)
    np.fill_diagonal(out, 1.0)
    return out


def _stated(metrics: tuple[Metric, ...], path: Path) -> Block:
    """Sigma and correlation from a file of n rows of n numbers, in the order of the metrics."""
    from dataclasses import replace

    lines = [numbers(cells) for cells in table_lines(read_text(path))]
    n = len(metrics)
    if len(lines) != n or any(line is None or len(line) != n for line in lines):
        raise InputError(f"{path}: holds no {n} x {n} numbers; the covariance needs one row and one column for each metric")
    matrix = np.array(lines, dtype=float)
    sigma = np.sqrt(np.maximum(np.diag(matrix), 0))
    scale = np.outer(sigma, sigma)
    if not np.all(sigma > 0) or not np.allclose(matrix, matrix.T, atol=1e-9 * scale.max()):
        raise InputError(f"{path}: is no covariance; it needs equal numbers on both sides of a diagonal that is above 0")
    if np.linalg.eigvalsh(matrix / scale)[0] < -1e-9:
        raise InputError(f"{path}: is no covariance (its smallest eigenvalue is below 0); correct the correlations")
    return Block(tuple(replace(m, sigma=float(s)) for m, s in zip(metrics, sigma, strict=True)), matrix / scale)
