"""Catalogue of the manipulation tasks, read from tasks.yaml."""

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from neoworld_mjx.config import read_yaml
from neoworld_mjx.errors import ConfigError, choices

from . import joint_tasks, pushing_tasks, stacking_tasks
from .carrying_tasks import carrying
from .task import ManipulationTask, TaskKind

FILE = Path(__file__).parent / "tasks.yaml"
MODULES = {
    "stacking": stacking_tasks,
    "pushing": pushing_tasks,
    "opening": joint_tasks,
    "closing": joint_tasks,
    "turning": joint_tasks,
    "assembling": stacking_tasks,
}
"""Module with the functions of each kind, for tasks that do not only carry an object."""


@functools.cache
def all_tasks() -> tuple[ManipulationTask, ...]:
    """Return the 84 tasks; their scenes are built on first use."""
    return tuple(
        _task(name, kind, row)
        for kind, rows in read_yaml(FILE, "tasks").items()
        for name, row in rows.items()
    )


def _task(name: str, kind: TaskKind, row: dict[str, Any]) -> ManipulationTask:
    if "carry" in row:
        make = functools.partial(carrying, name, _tuples(row))
    else:
        arguments = _tuples(row.get("with", {}))
        if MODULES[kind] is joint_tasks:
            arguments["template"] = row["object"]
            arguments["hold"] = joint_tasks.Hold(*arguments["hold"])
        make = functools.partial(getattr(MODULES[kind], row["make"]), **arguments)
    return ManipulationTask(name, kind, row["instruction"], row["object"], make)


def _tuples(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _tuples(inner) for key, inner in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


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
