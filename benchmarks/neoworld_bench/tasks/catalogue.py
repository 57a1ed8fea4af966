"""The table of the tasks."""

from neoworld_mjx.errors import ConfigError, choices

from .assembling_tasks import ASSEMBLING
from .inserting_tasks import INSERTING
from .joint_tasks import JOINTS
from .placing_tasks import PLACING
from .pushing_tasks import PUSHING
from .stacking_tasks import STACKING
from .task import ManipulationTask


def all_tasks() -> tuple[ManipulationTask, ...]:
    """List the 84 tasks, the number of the paper; nothing is built yet."""
    return (*PLACING, *INSERTING, *STACKING, *PUSHING, *JOINTS, *ASSEMBLING)


def task_names() -> tuple[str, ...]:
    """List the names of the tasks."""
    return tuple(task.name for task in all_tasks())


def find_task(name: str) -> ManipulationTask:
    """Return a task by name.

    Raises:
        ConfigError: there is none of the name.
    """
    by_name = {task.name: task for task in all_tasks()}
    if name not in by_name:
        raise ConfigError(f"task: {choices(name, by_name)}")
    return by_name[name]
