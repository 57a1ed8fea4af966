"""Scenarios of an object: falls, pushes, joint releases and joint drives.

A scenario consists of an initial state of the object and of forces over time. `Simulation.run` runs
all scenarios of an object in one batch. The two standard scenarios of the paper (Section 3.2, Step
3) are the fall named "fall" and the pushes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ..config import VerifyOptions
from .verdict import ScenarioKind

World = Literal["free", "fixed_base", "weightless"]
"""Environment of a scenario.

- "free": the object is free on the floor.
- "fixed_base": the object's base is fixed, and there is no floor.
- "weightless": the object's base is fixed, and there is neither floor nor gravity.
"""
SINGLE_DOF_TYPES = ("revolute", "continuous", "prismatic")
"""Types of joints with one degree of freedom. Ball joints are neither released nor driven."""
MOST_S = 40.0
"""Largest estimate of the processor time of an object's scenarios [s]; an object of 20 joints is
within it."""
DROP_HEIGHT_M = 0.005
"""Height of the free falls [m]."""
FALL_TILT_DEG = 3.0
"""Initial tilt of the tilted falls [deg]."""
STILL_S = 0.1
"""Time before a joint is driven [s]."""
DIRECTIONS = {
    "+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1),
    "-z": (0, 0, -1),
}  # fmt: skip


@dataclass(frozen=True)
class Scenario:
    """One scenario of an object."""

    kind: ScenarioKind
    name: str
    world: World
    height: float = 0.0
    """Initial height of the object's lowest point above the floor [m]."""
    tilt: tuple[float, float] = (0.0, 0.0)
    """Initial rotations about x and y relative to the orientation at rest [rad]."""
    joints: dict[str, float] = field(default_factory=dict)
    """Initial joint positions [rad or m]."""
    fixed_joints: frozenset[str] = frozenset()
    """Joints that are fixed at their initial positions, such as the door in front of a rack."""
    speeds: dict[str, float] = field(default_factory=dict)
    """Initial joint velocities [rad/s or m/s]."""
    part: str | None = None
    """Part that is pushed; None in scenarios without a push."""
    impulse: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Impulse of the push over the mass of the part and all parts that it carries [m/s]."""
    joint: str | None = None
    """Joint that is released or driven."""
    driven: bool = False
    """True if a force drives the joint up its range and down again."""


@dataclass(frozen=True)
class SingleJoint:
    """A joint with one degree of freedom that follows no other joint."""

    name: str
    child: str
    low: float
    """Lower limit [rad or m]; -pi for a continuous joint."""
    high: float
    """Upper limit [rad or m]; pi for a continuous joint."""
    has_spring: bool = False
    """True if the joint has a stiffness."""
    prerequisites: dict[str, float] = field(default_factory=dict)
    """Open positions [rad or m] of the joints that must be open before the joint moves."""


def list_scenarios(
    parts: list[str], joints: list[SingleJoint], options: VerifyOptions, *, fixed_base: bool
) -> list[Scenario]:
    """Return all scenarios of an object.

    Args:
        parts: one part of each group of parts that are fixed to each other, the root first.
        joints: joints with one degree of freedom that follow no other joint.
        options: height and impulse.
        fixed_base: if True, the base is fixed, and only the scenarios of the joints are returned.
    """
    scenarios = [] if fixed_base else [*_falls(), *_pushes(parts, options)]
    for joint in joints:
        scenarios += [*_releases(joint), *_drives(joint)]
    return scenarios


def affordable(
    scenarios: Sequence[Scenario], steps: int, dofs: int
) -> tuple[list[Scenario], list[str]]:
    """Return the scenarios to simulate, and the parts and joints that are left out.

    If all scenarios take over `MOST_S` by an estimate, those of parts and joints that are spread
    evenly over the object are simulated, so that the time of every object is bounded. The estimate
    depends on the object only, so equal objects have equal checks on every machine.

    Args:
        scenarios: all scenarios of an object; those without a part or joint are falls.
        steps: steps of each scenario.
        dofs: degrees of freedom of the object's model.
    """
    most = MOST_S / (steps * (4e-6 * dofs + 1.5e-9 * dofs**3))
    if len(scenarios) <= most:
        return list(scenarios), []
    subject = lambda scenario: scenario.part or scenario.joint
    subjects = list(dict.fromkeys(filter(None, map(subject, scenarios))))
    falls = [scenario for scenario in scenarios if subject(scenario) is None]
    falls = falls[: max(1, int(most))]
    share = max(0.0, most - len(falls)) / len(scenarios)
    count = int(share * len(subjects))
    kept = {subjects[int(k)] for k in np.linspace(0, len(subjects) - 1, count)}
    rest = [scenario for scenario in scenarios if subject(scenario) in kept]
    return [*falls, *rest], [name for name in subjects if name not in kept]


def _falls() -> list[Scenario]:
    """Return free falls: upright, tilted about x, and tilted about y."""
    lean = float(np.radians(FALL_TILT_DEG))
    height = DROP_HEIGHT_M
    return [
        Scenario("free_fall", "fall", "free", height=height),
        Scenario("free_fall", "fall_tilted_x", "free", height=height, tilt=(lean, 0.0)),
        Scenario("free_fall", "fall_tilted_y", "free", height=height, tilt=(0.0, lean)),
    ]


def _pushes(parts: list[str], options: VerifyOptions) -> list[Scenario]:
    """Return force perturbations: pushes of each part in six directions."""
    speed = options.impulse_ns_per_kg
    scenarios = []
    for part in parts:
        push = Scenario("force_perturbation", f"push:{part}:", "free", height=1e-4, part=part)
        for name, (x, y, z) in DIRECTIONS.items():
            impulse = (speed * x, speed * y, speed * z)
            scenarios.append(replace(push, name=push.name + name, impulse=impulse))
    return scenarios


def _releases(joint: SingleJoint) -> list[Scenario]:
    """Return releases of a joint.

    The joint is released with gravity at both limits and in the middle of its range, without
    gravity in the middle, and without gravity at an initial speed (coasting).
    """
    middle = (joint.low + joint.high) / 2
    # Without losses, a coasting joint reaches the end of its range after one second.
    speed = (joint.high - joint.low) / 2
    runs: list[tuple[str, World, float, dict[str, float]]] = [
        (f"release:{joint.name}:low", "fixed_base", joint.low, {}),
        (f"release:{joint.name}:middle", "fixed_base", middle, {}),
        (f"release:{joint.name}:high", "fixed_base", joint.high, {}),
        (f"still:{joint.name}", "weightless", middle, {}),
        (f"coast:{joint.name}", "weightless", middle, {joint.name: speed}),
    ]
    return [
        Scenario(
            "joint_release", name, world, joint=joint.name, speeds=speeds,
            joints={**joint.prerequisites, joint.name: position},
            fixed_joints=frozenset(joint.prerequisites),
        )
        for name, world, position, speeds in runs
    ]  # fmt: skip


def _drives(joint: SingleJoint) -> list[Scenario]:
    """Return drives of a joint to its upper limit and back, without and with gravity."""
    worlds: dict[str, World] = {"drive": "weightless", "drive_loaded": "fixed_base"}
    return [
        Scenario(
            "joint_drive", f"{name}:{joint.name}", world, joint=joint.name, driven=True,
            joints={**joint.prerequisites, joint.name: joint.low},
            fixed_joints=frozenset(joint.prerequisites),
        )
        for name, world in worlds.items()
    ]  # fmt: skip
