"""The version of the package: read by pyproject.toml, results and stores alike."""

VERSION = "0.2.0"
