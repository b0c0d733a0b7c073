"""Build and execute the notebooks: percent scripts of this folder -> .ipynb with their outputs.

    python analyses/notebooks/build.py [-o FOLDER] [--no-run] [NAME ...]

Needs the extra ``notebooks`` (jupytext, nbclient, ipykernel).  A name is the beginning of a file's name, such as 3.
"""

import argparse
from pathlib import Path

HERE = Path(__file__).resolve().parent
LONGEST_S = 1800  # of one cell: a diagnosis on a busy machine


def sources(names=()):
    """The scripts whose names begin with one of ``names``; all of them without."""
    every = sorted(path for path in HERE.glob("[0-9]_*.py"))
    return [path for path in every if not names or path.name.startswith(tuple(names))]


def build(path, folder, *, run=True):
    """One notebook, executed in its folder unless ``run`` is off; the file written."""
    import jupytext
    import nbformat
    from nbclient import NotebookClient

    notebook = jupytext.read(path)
    notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    if run:
        NotebookClient(
            notebook, timeout=LONGEST_S, kernel_name="python3", resources={"metadata": {"path": str(folder)}}
        ).execute()
    target = folder / f"{path.stem}.ipynb"
    nbformat.write(notebook, target)
    return target


def main():
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("notebooks"), help="folder of the notebooks (default: notebooks)"
    )
    parser.add_argument("--no-run", action="store_true", help="only convert")
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    for path in sources(args.names):
        print(build(path, args.output.resolve(), run=not args.no_run), flush=True)


if __name__ == "__main__":
    main()
