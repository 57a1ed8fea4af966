"""Notebooks in small form: their cells run in the test's own process, with some values replaced.

The notebooks themselves stay as a reader wants them, and so do the outputs that are committed.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jupytext

FOLDER = Path(__file__).parents[2] / "notebooks"


def run_small(name: str, changes: Mapping[str, str], **given: Any) -> dict[str, Any]:
    """Run the code cells of a notebook.

    Args:
        name: of its file in notebooks/.
        changes: text of its cells that occurs once, and what stands in its place.
        given: names that are defined before the first cell.

    Returns:
        The names that the cells define.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    cells = jupytext.read(FOLDER / f"{name}.py").cells
    code = "\n\n".join(cell.source for cell in cells if cell.cell_type == "code")
    for text, other in changes.items():
        assert code.count(text) == 1, f"{name} holds {text!r} {code.count(text)} times"
        code = code.replace(text, other)
    space: dict[str, Any] = {"__name__": name, **given}
    exec(compile(code, f"{name}.ipynb", "exec"), space)
    return space
