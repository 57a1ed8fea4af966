"""Tasks from a sentence, such as "open the top drawer by 80 %" or "place the can on the desk".

The words are matched with the names of the scene's joints and objects. A model reads sentences that
do not match: it answers with a kind of task and names, which are checked in the same way.
"""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Literal, get_args

from pydantic import BaseModel, ConfigDict, Field

from ..errors import SpecError, choices
from ..mllm import Panel, Request
from ..spec import SceneSpec
from .flying_gripper import handles
from .task import (
    Task,
    close_joint,
    insert,
    lift,
    movable_joints,
    open_joint,
    place,
    press,
    push,
    reach,
    stack,
    topple,
    turn,
    upright,
)

Kind = Literal[
    "reach", "open", "close", "press", "turn", "push", "lift", "place", "insert", "stack",
    "topple", "upright",
]  # fmt: skip
VERBS: dict[Kind, str] = {
    "upright": r"upright|stand up",
    "topple": r"topple|tip|knock|fell",
    "stack": r"stack|pile",
    "insert": r"insert",
    "place": r"place|put|set|drop|move(?= .*\b(?:on|in|into|onto)\b)",
    "lift": r"lift|pick|raise|grab|grasp|take",
    "open": r"open|pull",
    "close": r"close|shut",
    "press": r"press",
    "turn": r"turn|rotate|twist",
    "push": r"push|slide|move|shove",
    "reach": r"reach|touch|approach|go to",
}
"""Words for each kind of task; the first kind with a match is meant."""
JOINT_KINDS = ("open", "close", "press", "turn")
APART = re.compile(r"\b(?:onto|into|inside|on top of|on|in|at)\b")
AMOUNT = re.compile(r"(?<![\w.])(-?\d*\.?\d+)\s*(%|percent|cm|mm|m|deg|degrees|rad)?(?![\w.])")
SHARES = {"": 1.0, "%": 0.01, "percent": 0.01}
UNITS = {"cm": 0.01, "mm": 0.001, "m": 1.0, "deg": 0.0174533, "degrees": 0.0174533, "rad": 1.0}
SYSTEM = (
    "You name the robot task that an instruction asks for in a scene. Use only the kinds and the "
    "exact names that are listed. `name` is what the robot works on: a joint for open, close, "
    "press and turn, otherwise an object. `other` is the object on or in which it is placed. "
    "`amount` is the share of a joint's range, a height or displacement along x in m, or an angle "
    "in rad, or null; `aside` is a displacement along y in m."
)
SHARE = "share of the joint's range, such as 0.8 or 80 %"
BOUNDS: dict[Kind, tuple[float, str]] = {
    "open": (1.0, SHARE),
    "close": (1.0, SHARE),
    "press": (1.0, SHARE),
    "turn": (2 * math.pi, "angle in rad, such as 1.5 or 90 deg"),
    "lift": (2.0, "height in m, such as 0.1 or 10 cm"),
    "push": (2.0, "displacement along x (and y) in m, such as 0.1 or 0.1 -0.05"),
}
"""Largest amount of each kind of task that takes one, and its meaning."""


class NamedTask(BaseModel):
    """A task as a model names it."""

    model_config = ConfigDict(extra="forbid")

    kind: Kind
    name: str = Field(max_length=100)
    other: str | None = Field(default=None, max_length=100)
    inside: bool = False
    """True if the object is placed in the other, not on it."""
    amount: float | None = None
    aside: float | None = None
    """Displacement of a push along y [m]."""


def task_of(scene: SceneSpec, words: str, panel: Panel | None = None) -> Task:
    """Return the task that a sentence asks for.

    Args:
        scene: the scene.
        words: the sentence, or a kind and names, such as "open cabinet-drawer_top 0.8".
        panel: a model that names the task if the words do not match; by default none is asked.

    Raises:
        SpecError: the words match no kind, or none or several of the names; the error lists them;
            or an amount is not within its bounds.
    """
    try:
        named = _matched(scene, words)
    except SpecError:
        if panel is None:
            raise
        named = panel.ask_sync(task_request(scene, words)).value
    return replace(make_task(scene, named), instruction=" ".join(words.split()))


def make_task(scene: SceneSpec, named: NamedTask) -> Task:
    """Return the task of a kind with exact names.

    Raises:
        SpecError: the scene has no such name, the kind does not fit, or an amount is not within its
            bounds.
    """
    a, aside = named.amount, named.aside or 0.0
    given = () if a is None else (a,)
    if a is not None and named.kind in BOUNDS:
        most, meaning = BOUNDS[named.kind]
        size = math.hypot(a, aside) if named.kind == "push" else abs(a)
        if not 0 < size <= most or (a < 0 and named.kind not in ("turn", "push")):
            raise SpecError(
                f"task {named.kind} {named.name}: {a:g} is no {meaning}; at most {most:.3g}"
            )
    makers: dict[Kind, Callable[[], Task]] = {
        "reach": lambda: reach(scene, named.name),
        "open": lambda: open_joint(scene, named.name, *given),
        "close": lambda: close_joint(scene, named.name, *given),
        "press": lambda: press(scene, named.name, *given),
        "turn": lambda: turn(scene, named.name, *given),
        "push": lambda: push(scene, named.name, *(() if a is None else ((a, aside),))),
        "lift": lambda: lift(scene, named.name, *given),
        "place": lambda: place(
            scene, named.name, **{"in_" if named.inside else "on": named.other or ""}
        ),
        "insert": lambda: insert(scene, named.name, named.other or ""),
        "stack": lambda: stack(scene, named.name, named.other or ""),
        "topple": lambda: topple(scene, named.name),
        "upright": lambda: upright(scene, named.name),
    }
    return makers[named.kind]()


def task_request(scene: SceneSpec, words: str) -> Request[NamedTask]:
    """Return the request that asks a model for the task."""
    joints, objects = _joint_names(scene), [item.name for item in scene.objects]
    prompt = (
        f"Kinds: {', '.join(get_args(Kind))}\nJoints, named after the parts that they move: "
        f"{', '.join(joints) or 'none'}\nObjects: {', '.join(objects)}\n\n"
        f"Instruction: {words[:400]}"
    )
    return Request("reasoner", "task", SYSTEM, prompt, NamedTask)


def _matched(scene: SceneSpec, words: str) -> NamedTask:
    text = " ".join(words.split())
    spoken = text.lower()
    kind: Kind | None = next(
        (k for k, verb in VERBS.items() if re.search(rf"\b(?:{verb})", spoken)), None
    )
    if re.search(r"\b(?:don'?t|not|never)\b", spoken):
        raise SpecError(f"task {text!r}: say what to do, not what not to do")
    if kind is None:
        raise SpecError(f"task {text!r}: no verb of a task; valid are: {', '.join(get_args(Kind))}")
    joints = _joint_names(scene)
    objects = {item.name: f"{item.name} {item.spec.label}" for item in scene.objects}
    # The verb is no part of a name: a microwave that is to be opened is not its button "open".
    spoken = re.sub(rf"\b(?:{VERBS[kind]})\w*", "", spoken, count=1)
    first, *rest = APART.split(spoken, maxsplit=1)
    if kind in JOINT_KINDS:
        name = _named(text, spoken, joints, "joint")
        amount, _, unit = _amounts(spoken, name)
        if amount is not None and kind != "turn" and unit in UNITS:
            owner, part = name.split("-", 1)
            moved = next(j for j in scene.object(owner).spec.joints if j.child == part)
            amount /= max(moved.upper - moved.lower, 1e-6)
        return NamedTask(kind=kind, name=name, amount=amount)
    if kind in ("place", "insert", "stack"):
        if not rest:
            parts = _names_in(spoken, objects)
            if len(parts) != 2:
                raise SpecError(f"task {text!r}: say on or in which object")
            return NamedTask(kind=kind, name=parts[0], other=parts[1])
        inside = re.search(r"\b(?:in|into|inside)\b", spoken) is not None
        return NamedTask(
            kind=kind,
            name=_named(text, first, objects, "object"),
            other=_named(text, rest[0], objects, "object"),
            inside=inside,
        )
    if kind == "reach":
        objects |= joints
    name = _named(text, spoken, objects, "object")
    amount, second, _ = _amounts(spoken, name)
    return NamedTask(kind=kind, name=name, amount=amount, aside=second)


def _amounts(spoken: str, name: str) -> tuple[float | None, float | None, str]:
    """Return the first two amounts of a sentence in SI units or as shares, and their unit.

    A number that belongs to the name, such as in "drawer 2", is no amount.
    """
    numbers = [
        (value, unit)
        for value, unit in AMOUNT.findall(spoken)
        if unit or value not in _tokens(name)
    ]
    if not numbers:
        return (0.5 if "half" in spoken else None), None, ""
    unit = numbers[-1][1]  # also said for both numbers: 10 -5 cm
    factor = {**SHARES, **UNITS}
    first, *more = [float(value) * factor[own or unit] for value, own in numbers]
    return first, more[0] if more else None, unit


def _joint_names(scene: SceneSpec) -> dict[str, str]:
    """Return the names of the joints that tasks may move, with the words for each."""
    return {
        f"{item.name}-{joint.child}": f"{item.name} {item.spec.label} {joint.child} {joint.name}"
        for item, joint in movable_joints(scene)
    }


def _names_in(spoken: str, known: dict[str, str]) -> list[str]:
    found = [(spoken.find(name.lower()), name) for name in known if name.lower() in spoken]
    return [name for _, name in sorted(found)]


def _tokens(text: str) -> set[str]:
    return set(re.findall(r"[a-z]+|\d+", text.lower()))


def _named(text: str, spoken: str, known: dict[str, str], kind: str) -> str:
    """Return the name that shares the most words with a phrase.

    Raises:
        SpecError: none does, or several do alike.
    """
    whole = [name for name in known if name.lower() in spoken.split()]
    if whole:
        return max(whole, key=len)
    own = _tokens(spoken)
    scores = {name: len(own & _tokens(words)) for name, words in known.items()}
    best = max(scores.values(), default=0)
    # Among names that match alike, the one with the fewest words that were not said is meant.
    near = [name for name, score in scores.items() if score == best > 0]
    lacking = {name: len(_tokens(name) - own) for name in near}
    fits = [name for name in near if lacking[name] == min(lacking.values())]
    if len(fits) == 1:
        return fits[0]
    problem = f"it fits several {kind}s" if fits else f"it names no {kind} of the scene"
    raise SpecError(f"task {text!r}: {problem}: {choices(spoken.strip(), fits or known)}")


def gripper_of(task: Task) -> str:
    """Return the handle that a flying gripper faces at the start of a task.

    Raises:
        SpecError: the task does not work on a handle.
    """
    at = task.point
    for name, (item, frame) in handles(task.scene).items():
        if (item.name, frame.part, frame.pos) == (at.object, at.part, at.pos):
            return name
    raise SpecError(
        f"task {task.instruction!r} works on {at.object} and not on a handle, which a flying "
        "gripper has to face: name a robot, such as --robot panda"
    )
