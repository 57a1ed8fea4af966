"""Manipulation tasks: a free gripper, plans, success on simulated states, and 84 tasks.

`all_tasks` lists them; `task.scene`, `task.predicate` and `task.plan` are made when they are asked
for. `execute` runs any plan in any scene.
"""

from .catalogue import all_tasks, find_task, task_names
from .execution import Outcome, execute, wait
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
    "wait",
]
