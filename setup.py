"""The wheel carries the top-level ``data`` folder as ``isetval/data``; everything else is in pyproject.toml."""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py


class BuildWithData(build_py):
    """Copies the data folder beside the modules (an editable install reads it from the checkout)."""

    def run(self) -> None:
        """Build the modules, then copy the data."""
        super().run()
        if not self.editable_mode:
            target = Path(self.build_lib) / "isetval" / "data"
            shutil.rmtree(target, ignore_errors=True)
            shutil.copytree("data", target, ignore=shutil.ignore_patterns("__pycache__"))


setup(cmdclass={"build_py": BuildWithData})
