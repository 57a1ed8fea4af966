"""Tables of the results in a folder: scenes, joints, tasks, real photographs."""

from pathlib import Path
from typing import Any

from neoworld_mjx.errors import RunError
from neoworld_mjx.io.files import write_atomic

from ..methods.scene_runs import RESULTS
from ..objects.object_scores import SCORES, stored_scores
from ..real_poses.real_views import OBJECTS, stored_real_rows
from ..tasks.success_runs import SUCCESSES, known_successes
from .joint_table import joint_table
from .real_table import real_table
from .scene_table import scene_tables
from .success_table import success_table


def write_tables(folder: Path) -> dict[str, Any]:
    """Write the tables of the rows in a folder: table.* and curves.* of scenes, joints.*,
    tasks.*, real.*.

    Raises:
        RunError: it has no rows, or a file cannot be written.
    """
    texts: dict[str, str] = {}
    if (folder / RESULTS).exists():
        texts |= scene_tables(folder)
    if rows := stored_scores(folder):
        texts |= joint_table(rows).files("joints")
    if successes := known_successes(folder):
        texts |= success_table(successes).files("tasks")
    if real := stored_real_rows(folder)[1]:
        texts |= real_table(real).files("real")
    if not texts:
        raise RunError(
            f"{folder} has no rows yet, no {RESULTS}, {SCORES}, {SUCCESSES} or {OBJECTS}; "
            "`neoworld bench run` with scenes, joints, task-success or real-poses and --out makes "
            "them"
        )
    for name, text in texts.items():
        try:
            write_atomic(folder / name, text)
        except OSError as error:
            raise RunError(f"cannot write {folder / name}: {error.strerror}") from None
    return {"files": [str(folder / name) for name in texts]}
