"""A manipulation task: an instruction, a scene, what success is, and a reference plan."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

from neoworld_mjx.environments.predicates import Every, Located, Predicate
from neoworld_mjx.spec import SceneSpec

from .plan_format import TaskPlan
from .task_scenes import in_other

TaskKind = Literal[
    "placement",
    "insertion",
    "stacking",
    "pushing",
    "opening",
    "closing",
    "turning",
    "assembling",
]


Planner = Callable[[SceneSpec], TaskPlan]
"""Plans in a scene of a task's objects, at whatever poses and sizes they have there."""


class Prepared(NamedTuple):
    """Scene, predicate and plan of a task, computed from its programs."""

    scene: SceneSpec
    predicate: Predicate
    planner: Planner
    condition: Callable[[SceneSpec], Predicate] | None = None
    """The predicate in another scene of the same objects, where places on the table come from
    objects; None keeps what it says of each object's own frame."""


@dataclass(frozen=True)
class ManipulationTask:
    """One task of the benchmark."""

    name: str
    kind: TaskKind
    instruction: str
    """In English, for a model or a person who sees the scene."""
    object: str
    """The object concerned: the one that the gripper works on."""
    make: Callable[[], Prepared]

    @cached_property
    def prepared(self) -> Prepared:
        """Scene, predicate and reference plan."""
        return self.make()

    @property
    def scene(self) -> SceneSpec:
        """The true scene."""
        return self.prepared.scene

    @property
    def predicate(self) -> Predicate:
        """Condition of success."""
        return self.prepared.predicate

    @cached_property
    def plan(self) -> TaskPlan:
        """The reference plan, from the ground truth."""
        return self.plan_in(self.scene)

    def plan_in(self, scene: SceneSpec) -> TaskPlan:
        """Plan in a scene of the same objects, such as a reconstruction, and from nothing else.

        Points of an object that the task names, such as where it is held, are taken at the same
        share of its box.

        Raises:
            ValueError: the plan would leave its bounds, such as fingers that open too little.
        """
        return self.prepared.planner(scene)

    def predicate_in(self, scene: SceneSpec) -> Predicate:
        """Return what success is in a scene of the same objects, such as a reconstruction.

        Targets lie at the same share of an object's box; bounds about them stay.
        """
        condition = self.prepared.condition
        return (
            _in_other(self.predicate, self.scene, scene) if condition is None else condition(scene)
        )

    def with_object(self, name: str, **update: Any) -> SceneSpec:
        """Return the scene with fields of one object replaced."""
        objects = tuple(
            item.model_copy(update=update) if item.name == name else item
            for item in self.scene.objects
        )
        return self.scene.model_copy(update={"objects": objects})


def _in_other(predicate: Predicate, truth: SceneSpec, scene: SceneSpec) -> Predicate:
    if isinstance(predicate, Every):
        parts = [_in_other(part, truth, scene) for part in predicate.of]
        return predicate.model_copy(update={"of": tuple(parts)})
    if not isinstance(predicate, Located):
        return predicate
    return predicate.model_copy(
        update={
            "point": in_other(truth, scene, predicate.object, predicate.point),
            "target": in_other(truth, scene, predicate.relative_to, predicate.target),
        }
    )
