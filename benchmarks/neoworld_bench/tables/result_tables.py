"""Tables of the rows in a folder: scenes and tasks."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from neoworld_mjx.errors import RunError
from neoworld_mjx.io.files import write_output

from ..methods.scene_runs import SceneRow
from ..rows import ROWS, RowStore
from ..tasks.success_runs import SuccessRow
from .scene_table import scene_table
from .task_table import task_table

TABLES: dict[str, tuple[type[Any], Callable[..., Any]]] = {
    "scenes": (SceneRow, scene_table),
    "tasks": (SuccessRow, task_table),
}
"""Kind of row and function of each table, by the name of its files."""


def write_tables(folder: Path) -> dict[str, Any]:
    """Write the tables of the rows in a folder, in Markdown and CSV.

    Raises:
        RunError: it has no rows, or a file cannot be written.
    """
    store = RowStore(folder / ROWS if (folder / ROWS).exists() else None)
    files = []
    for name, (kind, table_of) in TABLES.items():
        if not (rows := store.of(kind)):
            continue
        table = table_of(rows)
        for suffix, text in (("md", table.markdown()), ("csv", table.comma_separated())):
            write_output(folder / f"{name}.{suffix}", text, RunError)
            files.append(str(folder / f"{name}.{suffix}"))
    if not files:
        raise RunError(
            f"{folder} has no rows yet, no {ROWS}; `neoworld bench run` with scenes or tasks "
            "and --out makes them"
        )
    return {"files": files}
