"""Catalogue of the manipulation tasks, read from tasks.yaml."""

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from neoworld_mjx.config import read_yaml
from neoworld_mjx.errors import ConfigError, choices

from . import inserting_tasks, joint_tasks, placing_tasks, pushing_tasks, stacking_tasks
from . import stacking_tasks as assembling_tasks
from .task import ManipulationTask, TaskKind

FILE = Path(__file__).parent / "tasks.yaml"
MODULES = {
    "placement": placing_tasks,
    "insertion": inserting_tasks,
    "stacking": stacking_tasks,
    "pushing": pushing_tasks,
    "opening": joint_tasks,
    "closing": joint_tasks,
    "turning": joint_tasks,
    "assembling": assembling_tasks,
}
"""Module that builds the tasks of each kind."""


@functools.cache
def all_tasks() -> tuple[ManipulationTask, ...]:
    """Return the 84 tasks; their scenes are built on first use."""
    return tuple(
        _task(name, kind, row)
        for kind, rows in read_yaml(FILE, "tasks").items()
        for name, row in rows.items()
    )


def _task(name: str, kind: TaskKind, row: dict[str, Any]) -> ManipulationTask:
    arguments = {key: _tuples(value) for key, value in row.get("with", {}).items()}
    if MODULES[kind] is joint_tasks:
        arguments["template"] = row["object"]
        arguments["hold"] = joint_tasks.Hold(*arguments["hold"])
    make = functools.partial(getattr(MODULES[kind], row["make"]), **arguments)
    return ManipulationTask(name, kind, row["instruction"], row["object"], make)


def _tuples(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


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
