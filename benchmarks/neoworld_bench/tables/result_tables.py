"""Tables of the results in a folder: scenes and tasks."""

from pathlib import Path
from typing import Any

from neoworld_mjx.errors import RunError
from neoworld_mjx.io.files import write_atomic

from ..methods.scene_runs import RESULTS
from ..tasks.success_runs import SUCCESSES, known_successes
from .scene_table import scene_tables
from .success_table import success_table


def write_tables(folder: Path) -> dict[str, Any]:
    """Write the tables of the rows in a folder: table.* and curves.* of scenes, and tasks.*.

    Raises:
        RunError: it has no rows, or a file cannot be written.
    """
    texts: dict[str, str] = {}
    if (folder / RESULTS).exists():
        texts |= scene_tables(folder)
    if successes := known_successes(folder):
        texts |= success_table(successes).files("tasks")
    if not texts:
        raise RunError(
            f"{folder} has no rows yet, neither {RESULTS} nor {SUCCESSES}; `neoworld bench run` "
            "with scenes or task-success and --out makes them"
        )
    for name, text in texts.items():
        try:
            write_atomic(folder / name, text)
        except OSError as error:
            raise RunError(f"cannot write {folder / name}: {error.strerror}") from None
    return {"files": [str(folder / name) for name in texts]}
