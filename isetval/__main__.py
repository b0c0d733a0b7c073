"""``python -m isetval`` is the command line."""

from isetval.app.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
