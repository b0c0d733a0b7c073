"""All commands and their options."""

from __future__ import annotations

import argparse

from isetval.app.cli.archive_commands import register as register_archive
from isetval.app.cli.cache_command import register as register_cache
from isetval.app.cli.camera_commands import register as register_cameras
from isetval.app.cli.completion_command import register as register_completion
from isetval.app.cli.edge_command import register as register_edge
from isetval.app.cli.inspection_commands import register as register_show
from isetval.app.cli.laboratory_commands import register as register_lab
from isetval.app.cli.laboratory_commands import register_demo
from isetval.app.cli.loop_commands import register as register_loop
from isetval.app.cli.measure_command import register as register_measure
from isetval.app.cli.region_commands import register as register_roi

EPILOG = """\
the loop:
  isetval compare  model.toml captures/                      where does the model fail
  isetval identify model.toml plan.toml                      what could be told apart, before measuring
  isetval diagnose model.toml captures/ -o d.json            which effect is missing, how sure, what else, what next
  isetval add      model.toml EFFECT --from d.json -o model2.toml
  isetval compare  model.toml model2.toml captures/          how the error fell

exit codes: 0 fine, 1 outside limits, 2 usage, 3 bad input, 4 missing optional part (70: a defect of isetval)
with --json the result goes to stdout and all words to stderr; -o writes it to a file (.json, or .csv for its table)
"""


def common_options() -> argparse.ArgumentParser:
    """Options that every command has."""
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--json", action="store_true", help="result as JSON on stdout, words on stderr")
    common.add_argument("-q", "--quiet", action="store_true", help="nothing but errors and JSON")
    common.add_argument("-v", "--verbose", action="store_true", help="every step, warnings, and where an internal error arose")
    common.add_argument("--dry-run", action="store_true", help="tell what would be read and written, and do nothing")
    common.add_argument(
        "--allow-plugin", action="store_true", help="run the program that a model file names as plugin (read it first)"
    )
    common.add_argument("-o", "--output", metavar="PATH", help="where to write the result")
    common.set_defaults(suffixes=())  # what -o may end in beside the result's own, or instead of it
    return common


def build_parser() -> argparse.ArgumentParser:
    """The parser of the whole command line."""
    import isetval

    parser = argparse.ArgumentParser(
        prog="isetval",
        description="A ruler and a detective for camera models: measure captures and simulations alike, compare them, "
        "name the physics that the model lacks, add it, and watch the error fall.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"isetval {isetval.__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    common = common_options()
    for group in (
        register_demo,
        register_measure,
        register_loop,
        register_lab,
        register_archive,
        register_show,
        register_cache,
        register_completion,
        register_roi,
        register_edge,
        register_cameras,
    ):
        group(commands, common)
    return parser
