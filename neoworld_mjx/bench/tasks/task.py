"""A manipulation task: an instruction, a scene, what success is, and a reference plan."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from ...spec import SceneSpec, bounds
from .plan_format import TaskPlan
from .predicates import Predicate

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


class Prepared(NamedTuple):
    """What a task is made of, computed from its programs."""

    scene: SceneSpec
    predicate: Predicate
    plan: TaskPlan
    """The reference plan, from the truth."""


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
        """What success is."""
        return self.prepared.predicate

    @property
    def plan(self) -> TaskPlan:
        """The reference plan."""
        return self.prepared.plan

    def displaced(self, heading: float) -> SceneSpec:
        """Move the object concerned by half its largest horizontal edge.

        What carries it, but for the table, moves with it: a pencil that stands in a holder would
        else stand in the holder's wall.

        Args:
            heading: direction in the table's frame [rad].
        """
        item = self.scene.object(self.object)
        low, high = bounds(item.spec, item.joint_state, item.base_tilt)
        step = float((high - low)[:2].max()) / 2
        while item.parent is not None and not self.scene.object(item.parent).environment:
            item = self.scene.object(item.parent)
        xy = np.array(item.xy) + step * np.array([np.cos(heading), np.sin(heading)])
        return self.with_object(item.name, xy=(float(xy[0]), float(xy[1])))

    def with_object(self, name: str, **update: Any) -> SceneSpec:
        """Return the scene with fields of one object replaced."""
        objects = tuple(
            item.model_copy(update=update) if item.name == name else item
            for item in self.scene.objects
        )
        return self.scene.model_copy(update={"objects": objects})
