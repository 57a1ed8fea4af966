"""Tasks from words: `open cabinet-drawer_top 0.8`."""

import inspect

from ..errors import SpecError, choices
from ..spec import SceneSpec
from .controlled_scene import handles
from .task import KINDS, Task


def task_of(scene: SceneSpec, words: str) -> Task:
    """Return the task that words name: a kind, and the names and numbers that its maker takes.

    Raises:
        SpecError: there is no such kind, or the scene has no such joint or object.
    """
    parts = words.split()
    if not parts:
        raise SpecError("task: it is empty; give a kind and a name, such as open cabinet-drawer")
    kind, given = parts[0], parts[1:]
    if kind not in KINDS:
        raise SpecError(f"task: kind: {choices(kind, KINDS)}")
    maker = KINDS[kind]
    takes = list(inspect.signature(maker).parameters.values())[1:]
    values: dict[str, object] = {}
    for parameter, text in zip(takes, given, strict=False):
        try:
            number = isinstance(parameter.default, float)
            values[parameter.name] = float(text) if number else text
        except ValueError:
            raise SpecError(f"task {kind}: {parameter.name} is {text!r}, not a number") from None
    if len(given) > len(takes) or not values:
        raise SpecError(f"task {kind}: it takes {', '.join(p.name for p in takes)}")
    return maker(scene, **values)


def gripper_of(task: Task) -> str:
    """Return the handle that a flying gripper faces at the start of a task.

    Raises:
        SpecError: the task does not work on a handle.
    """
    at = task.point
    for name, (item, frame) in handles(task.scene).items():
        if (item.name, frame.part, frame.pos) == (at.object, at.part, at.pos):
            return name
    raise SpecError(f"task {task.instruction!r} has no handle for a flying gripper: give a robot")
