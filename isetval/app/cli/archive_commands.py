"""``isetval archive add | query | trend`` and ``isetval store show | merge``."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isetval.app.cli.console import Console
from isetval.app.cli.outcome import FINE, OUTSIDE_LIMITS, PAGE_SUFFIXES, Outcome
from isetval.app.cli.tables import text_table

if TYPE_CHECKING:
    from isetval.app.archive.trend import Trend

MOST_SHOWN = 40  # rows on the screen


def register(commands: Any, common: argparse.ArgumentParser) -> None:
    """The commands and their options."""
    archive = commands.add_parser("archive", help="measurements of many captures: add, ask in SQL, draw against time")
    actions = archive.add_subparsers(metavar="ACTION", required=True)
    p = actions.add_parser("add", parents=[common], help="stores and results -> rows of an archive", description=add.__doc__)
    p.add_argument("archive", type=Path, metavar="ARCHIVE", help="folder of the archive; made if it is not there")
    p.add_argument(
        "sources", type=Path, nargs="+", metavar="SOURCE", help="folders of 'measure --store', JSON results of measure"
    )
    p.add_argument("--body", default="", help="name of the device, where the files' serial number is not it")
    p.set_defaults(handler=add, writes_result=True)
    p = actions.add_parser("query", parents=[common], help="a question in SQL on the table 'metrics'", description=query.__doc__)
    p.add_argument("archive", type=Path, metavar="ARCHIVE")
    p.add_argument("sql", nargs="?", default="", metavar="SQL", help="without it: what the archive holds")
    p.set_defaults(handler=query, writes_result=True)
    p = actions.add_parser(
        "trend", parents=[common], help="a metric against time, and what left the limits", description=trend.__doc__
    )
    p.add_argument("archive", type=Path, metavar="ARCHIVE")
    p.add_argument("metric", metavar="METRIC", help="as mtf50, read_noise_e, plane_mean")
    p.add_argument("--channel", default="", help="only this channel")
    p.add_argument("--body", default="", help="only this device")
    p.add_argument("--where", default="", metavar="SQL", help="a further condition, as \"iso = 100 AND setup LIKE '%%rig2%%'\"")
    p.add_argument("--low", type=float, help="lower limit; without limits the series' own band counts")
    p.add_argument("--high", type=float, help="upper limit")
    p.set_defaults(handler=trend, writes_result=True, suffixes=PAGE_SUFFIXES)
    store = commands.add_parser("store", help="records of 'measure --store': show, merge").add_subparsers(
        metavar="ACTION", required=True
    )
    p = store.add_parser("show", parents=[common], help="how many records a store holds", description=show.__doc__)
    p.add_argument("store", type=Path, metavar="STORE")
    p.set_defaults(handler=show, writes_result=True)
    p = store.add_parser("merge", parents=[common], help="take over the records of other stores", description=merge.__doc__)
    p.add_argument("store", type=Path, metavar="STORE", help="where they go; made if it is not there")
    p.add_argument("others", type=Path, nargs="+", metavar="OTHER", help="stores of other shards or machines")
    p.set_defaults(handler=merge, writes_result=True)


def add(args: argparse.Namespace, console: Console) -> Outcome:
    """Add rows of stores and results to an archive; records that are there already are left alone."""
    from isetval.app.archive.dataset import Archive

    console.say(f"adding to {args.archive}")
    archive = Archive(args.archive)
    records, rows = archive.add(args.sources, body=args.body)
    lines = [f"{records} new records, {rows} rows, in {args.archive}"]
    return Outcome({"kind": "archive add", "records": records, "rows": rows}, lines, FINE)


def query(args: argparse.Namespace, console: Console) -> Outcome:
    """Answer a question in SQL (DuckDB) on the table 'metrics'; -o NAME.csv writes the answer as a table."""
    from isetval.app.archive.dataset import TABLE, Archive

    sql = args.sql or (
        f"SELECT metric, unit, count(*) AS n, count(DISTINCT record) AS captures, count(DISTINCT body) AS bodies, "
        f"min(date) AS first, max(date) AS last FROM {TABLE} GROUP BY metric, unit ORDER BY n DESC, metric"
    )
    names, rows = Archive(args.archive).query(sql)
    table = [dict(zip(names, row, strict=True)) for row in rows]
    lines = text_table(names, [[_cell(v) for v in row] for row in rows[:MOST_SHOWN]]) if names else []
    lines += [f"and {len(rows) - MOST_SHOWN} more rows (all with --json or -o)"] if len(rows) > MOST_SHOWN else []
    return Outcome({"kind": "archive query", "sql": sql, "rows": table}, lines, FINE, {}, table)


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return "" if value is None else str(value)


def trend(args: argparse.Namespace, console: Console) -> Outcome:
    """Draw a metric against time with its band, and list the captures that left the limits (exit code 1 if limits were given)."""
    from isetval.app.archive.dataset import Archive
    from isetval.app.archive.trend import trend_of

    trends = trend_of(
        Archive(args.archive),
        args.metric,
        channel=args.channel,
        body=args.body,
        where=args.where,
        low=args.low,
        high=args.high,
    )
    left = [row for t in trends for row in _left(t)]
    table = [row for t in trends for row in _summary(t)]
    given = args.low is not None or args.high is not None
    header = ("body", "channel", "n", "median", "spread", "drift a year", "outside")
    lines = [f"# {args.metric}", *text_table(header, [tuple(row.values()) for row in table])]
    lines += [
        f"outside: {row['file'] or row['date']}: {row['value']:.6g} {row['unit']}, {row['words']}" for row in left[:MOST_SHOWN]
    ]
    lines += [f"and {len(left) - MOST_SHOWN} more (all with --json or -o)"] if len(left) > MOST_SHOWN else []
    result = {"kind": "archive trend", "metric": args.metric, "series": table, "outside": left, "notes": []}

    def page(suffix: str, whole: Mapping[str, Any]) -> bytes:
        from isetval.app.report.measurement import measurement_html, measurement_picture

        sheets = _sheets(trends)
        if suffix in (".pdf", ".png"):
            return measurement_picture(sheets, suffix[1:])
        return measurement_html({**whole, "campaign": f"{args.metric} in {args.archive}"}, [], sheets).encode()

    return Outcome(result, lines, OUTSIDE_LIMITS if given and left else FINE, {}, left or table, page)


def _summary(t: Trend) -> list[dict[str, Any]]:
    unit = "" if t.unit in ("", "1") else f" {t.unit}"
    drift = "" if t.drift_per_year is None else f"{t.drift_per_year.value:+.3g} +- {t.drift_per_year.sigma:.2g}{unit}"
    return [
        {
            "body": t.body,
            "channel": t.channel,
            "n": len(t.values),
            "median": f"{t.center:.6g}{unit}",
            "spread": f"{t.spread:.2g}{unit}",
            "drift": drift,
            "outside": len(t.outside),
        }
    ]


def _left(t: Trend) -> list[dict[str, Any]]:
    """The captures of a series that left the limits."""
    out = []
    for i in t.outside:
        under = t.values[i] < t.low[i]
        limit = float(t.low[i] if under else t.high[i])
        words = f"{'below' if under else 'above'} {limit:.6g}"
        if t.sigmas[i] > 0:
            words += f" by {abs(t.values[i] - limit) / t.sigmas[i]:.1f} of its sigma"
        out.append(
            {
                "file": t.files[i],
                "date": None if t.dates[i] is None else str(t.dates[i]),
                "body": t.body,
                "channel": t.channel,
                "value": float(t.values[i]),
                "sigma": float(t.sigmas[i]),
                "unit": t.unit,
                "limit": limit,
                "words": words,
            }
        )
    return out


def _sheets(trends: list[Trend]) -> list[Any]:
    from isetval.app.plots.sheets import Sheet
    from isetval.app.plots.trend import plot_trend

    sheets = []
    for t in trends:
        title = " ".join(filter(None, (t.metric, t.body, t.channel)))
        rows = [("capture", "date", "value", "limit")]
        rows += [(Path(r["file"]).name, str(r["date"] or ""), f"{r['value']:.6g} {r['unit']}", r["words"]) for r in _left(t)]
        figure = plot_trend(t).figure
        sheets.append(Sheet(title, rows if len(rows) > 1 else (), [], figure, {}))  # type: ignore[arg-type]
    return sheets


def show(args: argparse.Namespace, console: Console) -> Outcome:
    """Count the records of a store."""
    from isetval.app.archive.rows import sources

    store = sources([args.store])[0][0]
    size = sum(path.stat().st_size for path in store.segments())
    lines = [f"{args.store}: {len(store)} records in {len(store.segments())} segments, {size / 1e6:.1f} MB"]
    return Outcome({"kind": "store", "records": len(store), "segments": len(store.segments()), "bytes": size}, lines, FINE)


def merge(args: argparse.Namespace, console: Console) -> Outcome:
    """Take over the records of other stores: what shards measured becomes one store, and 'measure --store' finds it there."""
    from isetval.app.batch.store import ResultStore

    store = ResultStore(args.store)
    new = store.merge(args.others)
    lines = [f"{args.store}: {new} new segments, {len(store)} records"]
    return Outcome({"kind": "store", "records": len(store), "new_segments": new}, lines, FINE)
