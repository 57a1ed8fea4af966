"""Manipulation tasks: 84 tasks, plans of a free gripper, their execution and success predicates.

`all_tasks` lists the tasks; `task.scene`, `task.predicate` and `task.plan` are built on first use.
`execute` runs a plan in a scene.
"""

from .catalogue import all_tasks, find_task, task_names
from .execution import Outcome, execute
from .plan_format import TaskPlan, ToolMove
from .task import ManipulationTask

__all__ = [
    "ManipulationTask",
    "Outcome",
    "TaskPlan",
    "ToolMove",
    "all_tasks",
    "execute",
    "find_task",
    "task_names",
]
