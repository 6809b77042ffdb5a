"""Runs notebooks and keeps what they print and draw: `python notebooks/run.py [FILE ...]`; all of them without a file.

A notebook is written when it has come to its end; one that fails stays as it was.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

FOLDER = Path(__file__).resolve().parent


def execute(
    notebook: Any, folder: Path, timeout_s: float | None = None, say: Callable[[str], object] = lambda line: None
) -> None:
    """Run all cells of a notebook in place, in a fresh kernel of this Python that finds this checkout.

    Args:
        notebook: as nbformat reads it; outputs are replaced.
        folder: the cells' working directory.
        timeout_s: of each cell; none when None.
        say: takes a line for each code cell that begins.

    Raises:
        CellExecutionError: a cell failed.
        CellTimeoutError: a cell took too long.
    """
    code = [place for place, cell in enumerate(notebook.cells) if cell.cell_type == "code"]
    client = NotebookClient(
        notebook,
        timeout=timeout_s,
        kernel_name="python3",
        record_timing=False,  # or each run changes every cell
        coalesce_streams=True,
        resources={"metadata": {"path": str(folder)}},
        on_cell_execute=lambda cell, cell_index: say(f"cell {code.index(cell_index) + 1} of {len(code)}"),
    )
    paths = [str(FOLDER.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    client.execute(env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)})


def main(files: list[str]) -> int:
    """Run the notebooks named, or all; returns the exit code."""
    for path in map(Path, files) if files else sorted(FOLDER.glob("*.ipynb")):
        if not path.is_file():
            print(f"there is no notebook {path}", file=sys.stderr)
            return 2
        notebook = nbformat.read(path, as_version=4)
        try:
            execute(
                notebook, path.resolve().parent, say=lambda line, name=path.stem: print(f"{name}: {line}", flush=True)
            )
        except CellExecutionError as error:
            print(f"{path} failed and stays as it was\n{error}", file=sys.stderr)
            return 1
        part = path.with_suffix(".part")
        nbformat.write(notebook, part)
        os.replace(part, path)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
