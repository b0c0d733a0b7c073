"""The dataset: Parquet files that shards write side by side, read as one table by DuckDB.

A file holds rows of new records, is written whole, is named after its content and never changed.  Two shards that add the
same record at the same moment both write it; whoever reads takes each row once.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isetval.app.archive.rows import COLUMNS, Row, rows_of_result, rows_of_store, sources
from isetval.core.cache import bytes_hash
from isetval.core.errors import InputError, MissingPartError
from isetval.core.writing import replace_whole

if TYPE_CHECKING:
    import pandas as pd

PART_ROWS = 200_000  # of a file: some 10 MB, 100 MB while it is made
TABLE = "metrics"


class Archive:
    """Rows of many captures.

    Parameters
    ----------
    folder : path
        Made when the first rows are added.

    Raises
    ------
    MissingPartError
        Without the extra ``archive``.
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        try:
            import duckdb
            import pyarrow
        except ImportError:
            raise MissingPartError("an archive needs pyarrow and duckdb: pip install 'isetval[archive]'") from None
        self._duckdb: Any = duckdb
        self._arrow: Any = pyarrow

    def parts(self) -> list[Path]:
        """The files of the dataset."""
        return sorted(self.folder.glob("*.parquet"))

    def add(self, paths: Sequence[Path], *, body: str = "") -> tuple[int, int]:
        """Add what stores and results hold; (records, rows) that were new.

        Parameters
        ----------
        paths : sequence of path
            Folders of ``isetval measure --store`` and JSON results.
        body : str
            Name of the device, where the files' serial number is not it.

        Raises
        ------
        InputError
            For a path that is neither, or an archive that cannot be written.
        """
        stores, results = sources(paths)
        known = self._known()
        contents = [found for path in results for found in rows_of_result(path, body=body)]
        new = (found for found in contents if found and found[0]["record"] not in known)
        return self._write((*new, *()), (rows_of_store(store, body=body, known=known) for store in stores))

    def _write(self, given: Iterable[list[Row]], streams: Iterable[Iterable[list[Row]]]) -> tuple[int, int]:
        seen: set[str] = set()
        held: list[Row] = []
        rows = 0
        for stream in (given, *streams):
            for record in stream:
                if not record or record[0]["record"] in seen:
                    continue
                seen.add(record[0]["record"])
                held += record
                rows += len(record)
                if len(held) >= PART_ROWS:
                    self._part(held)
                    held = []
        if held:
            self._part(held)
        return len(seen), rows

    def _part(self, rows: Sequence[Row]) -> None:
        """Write rows as one file, sorted so that equal texts lie together."""
        import pyarrow.parquet

        arrow: Any = self._arrow
        schema = arrow.schema([(name, arrow.type_for_alias(kind)) for name, kind in COLUMNS.items()])
        ordered = sorted(rows, key=lambda row: (row["metric"], row["channel"] or "", row["record"], row["row"]))
        stream = io.BytesIO()
        pyarrow.parquet.write_table(arrow.Table.from_pylist(ordered, schema=schema), stream, compression="zstd")
        data = stream.getvalue()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            replace_whole(self.folder / f"{bytes_hash(data)[:32]}.parquet", data)
        except OSError as error:
            raise InputError(
                f"{self.folder}: the archive cannot be written ({error.strerror}); make room or choose another folder, "
                "and give the same command again: what was added stays"
            ) from None

    def _known(self) -> frozenset[str]:
        """Keys of the records that are there."""
        if not self.parts():
            return frozenset()
        return frozenset(row[0] for row in self._connection().execute(f"SELECT DISTINCT record FROM {TABLE}").fetchall())

    def _connection(self) -> Any:
        """A database of one view that can read the archive's folder and nothing else, and write nothing."""
        if not self.parts():
            raise InputError(f"{self.folder}: is no archive, or an empty one; add measurements with 'isetval archive add'")
        folder = str(self.folder.resolve())
        try:
            database = self._duckdb.connect(":memory:")
            database.execute(f"SET allowed_directories=[{_quoted(folder)}]")
            database.execute("SET enable_external_access=false")
            columns = ", ".join(f'"{name}"' for name in COLUMNS)
            database.execute(
                f"CREATE VIEW {TABLE} AS SELECT {columns} FROM ("
                f'SELECT *, row_number() OVER (PARTITION BY record, "row" ORDER BY filename) AS copy '
                f"FROM read_parquet({_quoted(folder + '/*.parquet')}, filename=true)) WHERE copy = 1"
            )
            database.execute("SET lock_configuration=true")
        except self._duckdb.Error as error:
            raise InputError(f"{self.folder}: cannot be read as an archive ({_first_line(error)})") from None
        return database

    def query(self, sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
        """Column names and rows of a question in SQL on the table ``metrics``.

        Raises
        ------
        InputError
            If it cannot be answered, with the database's own words.
        """
        database = self._connection()
        try:
            found = database.execute(sql)
            names = [column[0] for column in found.description or ()]
            return names, found.fetchall() if names else []
        except self._duckdb.Error as error:
            raise InputError(f"the question cannot be answered: {_first_line(error)}; columns: {', '.join(COLUMNS)}") from None
        finally:
            database.close()

    def frame(self, sql: str = f"SELECT * FROM {TABLE}") -> pd.DataFrame:
        """The answer to a question as a pandas table.

        Raises
        ------
        InputError
            As `query`.
        """
        import pandas as pd

        names, rows = self.query(sql)
        return pd.DataFrame(rows, columns=names)


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def _first_line(error: Exception) -> str:
    return str(error).split("\n")[0][:300]
