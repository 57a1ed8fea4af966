"""Catalogue of the manipulation tasks."""

from collections.abc import Sequence

from neoworld_mjx.errors import ConfigError, choices

from .assembling_tasks import ASSEMBLING
from .inserting_tasks import INSERTING
from .joint_tasks import JOINTS
from .placing_tasks import PLACING
from .pushing_tasks import PUSHING
from .stacking_tasks import STACKING
from .task import ManipulationTask


def all_tasks() -> tuple[ManipulationTask, ...]:
    """Return the 84 tasks, as many as the paper has; their scenes are built on first use."""
    return (*PLACING, *INSERTING, *STACKING, *PUSHING, *JOINTS, *ASSEMBLING)


def task_names() -> tuple[str, ...]:
    """Return the names of the tasks."""
    return tuple(task.name for task in all_tasks())


def find_task(name: str) -> ManipulationTask:
    """Return a task by name.

    Raises:
        ConfigError: there is no such task.
    """
    by_name = {task.name: task for task in all_tasks()}
    if name not in by_name:
        raise ConfigError(f"task: {choices(name, by_name)}")
    return by_name[name]


def find_tasks(names: Sequence[str]) -> list[ManipulationTask]:
    """Return tasks by name, all of them for no names.

    Raises:
        ConfigError: there is no task of a name.
    """
    return [find_task(name) for name in names] or list(all_tasks())
