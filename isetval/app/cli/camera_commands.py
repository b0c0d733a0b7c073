"""``isetval cameras``: the embedded camera models with the source of every number, and importers."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isetval.app.cli.console import Console
from isetval.app.cli.outcome import FINE, Outcome
from isetval.app.cli.tables import text_table
from isetval.core.errors import InputError

if TYPE_CHECKING:
    from isetval.camera.model import CameraModel

GEOMETRY = (("rows", int, "rows"), ("cols", int, "columns"), ("pixel-um", float, "pixel pitch"), ("bits", int, "bits"))
MARKS = ("stated", "measured", "estimated", "law")


def register(commands: Any, common: argparse.ArgumentParser) -> None:
    """The command and its options."""
    p = commands.add_parser("cameras", parents=[common], help="embedded camera models; importers", description=cameras.__doc__)
    p.add_argument("name", nargs="?", metavar="NAME", help="one of them with the source of every number, or: import")
    p.add_argument(
        "file", nargs="?", type=Path, metavar="FILE", help="of import: an ISETCam sensor (.mat), an EMVA 1288 datasheet"
    )
    for key, kind, words in GEOMETRY:
        p.add_argument(f"--{key}", type=kind, help=f"{words} of the sensor, which a datasheet does not state")
    p.add_argument("--cfa", default="MONO", help="colour pattern of a datasheet's sensor (default: %(default)s)")
    p.add_argument("--black-dn", type=float, default=0.0, help="black level of a datasheet's sensor (default: 0)")
    p.set_defaults(handler=cameras, writes_result=False, tells_dry_run=True)


def cameras(args: argparse.Namespace, console: Console) -> Outcome:
    """List the embedded cameras, with NAME show where each number of one comes from, or import one.

    Use one as isetval:NAME wherever a MODEL is asked for; isetval cameras import sensor.mat -o camera.toml makes one.
    """
    import isetval
    from isetval.camera.model_file import embedded_cameras

    if args.name == "import":
        return _import(args)
    if args.name:
        name = args.name if ":" in args.name or Path(args.name).exists() else f"isetval:{args.name}"
        return _one(isetval.load_model(name))
    models = [(name, isetval.load_model(name)) for name in embedded_cameras()]
    body = [
        (
            name,
            f"{m.sensor.rows} x {m.sensor.cols}",
            f"{m.sensor.pixel_um:g} um",
            m.sensor.cfa,
            f"{m.sensor.bits} bit",
            _counts(m),
        )
        for name, m in models
    ]
    lines = text_table(("camera", "pixels", "pitch", "pattern", "depth", "numbers"), body, indent=0)
    result = {"kind": "cameras", "cameras": [{"name": name, "parameters": _parameters(m)} for name, m in models]}
    return Outcome(
        result, [*lines, "sources of one: isetval cameras NAME; its file: MODEL = isetval:NAME in every command"], FINE
    )


def _one(model: CameraModel) -> Outcome:
    rows = _parameters(model)
    body = [(r["effect"], r["parameter"], r["value"], r["unit"], r["mark"], r["source"]) for r in rows]
    lines = [f"# {model.name}: {model.path}", *text_table(("effect", "parameter", "value", "unit", "is", "source"), body)]
    return Outcome({"kind": "cameras", "cameras": [{"name": model.name, "parameters": rows}]}, lines, FINE, {}, rows)


def _parameters(model: CameraModel) -> list[dict[str, Any]]:
    """One row a number that a model's effects hold, with its mark and source."""
    rows = []
    for effect in model.effects:
        mark, _, source = effect.source.partition(": ")
        if mark not in MARKS:
            mark, source = "", effect.source
        units = {p.name: p.unit for p in effect.parameters()}
        for key, value in effect.values().items() or {"": None}.items():
            shown = "" if value is None else f"{value:g}"
            row = {"effect": effect.name, "parameter": key, "value": shown, "unit": units.get(key, "")}
            rows.append(row | {"mark": mark, "source": source})
    return rows


def _counts(model: CameraModel) -> str:
    marks = [effect.source.partition(": ")[0] for effect in model.effects]
    return ", ".join(f"{marks.count(mark)} {mark}" for mark in MARKS if mark in marks)


def _import(args: argparse.Namespace) -> Outcome:
    from isetval.core.cache import file_hash
    from isetval.core.sensor import Sensor
    from isetval.files.emva_camera import read_emva_camera
    from isetval.files.isetcam_sensor import read_isetcam_sensor

    if args.file is None or args.output is None or not args.output.endswith(".toml"):
        raise InputError(
            "write: isetval cameras import FILE -o camera.toml (a .mat sensor of ISETCam, or an EMVA 1288 datasheet)"
        )
    target = Path(args.output)
    for path in (target, target.parent / "qe.csv"):
        if path.exists():
            raise InputError(f"{path}: exists already; write the model into a folder of its own")
    if args.dry_run:
        return Outcome({"kind": "dry run"}, [f"would read {args.file}", f"would write {target} and qe.csv beside it"], FINE)
    if args.file.suffix.lower() == ".mat":
        model = read_isetcam_sensor(args.file, target.parent)
    else:
        needed = {"--rows": args.rows, "--cols": args.cols, "--pixel-um": args.pixel_um, "--bits": args.bits}
        if missing := [name for name, value in needed.items() if value is None]:
            raise InputError(f"{args.file}: a datasheet does not state the sensor's geometry; add {', '.join(missing)}")
        sensor = Sensor(
            rows=args.rows, cols=args.cols, pixel_um=args.pixel_um, cfa=args.cfa.upper(), black_dn=args.black_dn,
            white_dn=2**args.bits - 1, bits=args.bits,
        )  # fmt: skip
        model = read_emva_camera(args.file, target.parent, sensor)
    model.save(target)
    lines = [f"{target}: {model.name}, {len(model.effects)} effects; check it: isetval cameras {target}"]
    result = {"kind": "cameras import", "file": str(target), "parameters": _parameters(model)}
    return Outcome(result, lines, FINE, {str(args.file): file_hash(args.file)})
