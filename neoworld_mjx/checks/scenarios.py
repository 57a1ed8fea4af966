"""Scenarios of an object: falls, pushes, releases, drives and a slope.

A scenario states the initial state of the object and the forces on it over time; `Simulation.run`
runs all scenarios of an object in one batch. The paper's two standard scenarios (Section 3.2, Step
3) are the fall named "fall" and the pushes.
"""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..config import VerifyOptions
from .verdict import ScenarioKind

World = Literal["free", "gripping", "held", "weightless"]
"""Free on the floor; free with contacts that do not creep; base held, without floor; base held,
without floor and gravity."""
SINGLE = ("revolute", "continuous", "prismatic")
"""Types of joints with one value; a ball joint is posed and pushed, but not driven."""
STILL_S = 0.1
"""Time a joint rests before it is driven."""
TILT_FROM_S, STEEPEST_DEG = 0.3, 70.0
"""Time at which the slope begins to rise, and its final angle."""
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
    """Initial height of its lowest point above the floor [m]."""
    tilt: tuple[float, float] = (0.0, 0.0)
    """Initial rotation about x and about y relative to its resting pose [rad]."""
    joints: dict[str, float] = field(default_factory=dict)
    """Initial joint positions [rad or m]."""
    propped: frozenset[str] = frozenset()
    """Joints held at their initial positions, such as the door of a cabinet whose rack moves."""
    speeds: dict[str, float] = field(default_factory=dict)
    """Initial joint velocities [rad/s or m/s]."""
    part: str | None = None
    """Part that is pushed."""
    impulse: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Impulse over the pushed mass [m/s]."""
    twist: float = 0.0
    """Angular velocity about the vertical that the push gives the pushed mass alone [rad/s]."""
    joint: str | None = None
    """Joint that is released or driven."""
    driven: bool = False
    slope: bool = False


@dataclass(frozen=True)
class SingleJoint:
    """A joint with one value that follows no other joint."""

    name: str
    child: str
    low: float
    high: float
    """Limits `low` and `high` [rad or m]; one turn for a continuous joint."""
    sprung: bool = False
    """True if it has stiffness."""
    opened: dict[str, float] = field(default_factory=dict)
    """Open positions of the joints that must open before it moves [rad or m]."""


def list_scenarios(
    parts: list[str], joints: list[SingleJoint], options: VerifyOptions, *, fixed_base: bool
) -> list[Scenario]:
    """List all scenarios of an object.

    Args:
        parts: one part of each group that moves together, the root first.
        joints: joints that follow no other.
        options: heights and impulses.
        fixed_base: True if the base is fixed; then only the scenarios of the joints are listed.
    """
    slope = Scenario("tilt_until_slide", "slope", "gripping", height=1e-4, slope=True)
    scenarios = [] if fixed_base else [*_falls(options), *_pushes(parts, options), slope]
    for joint in joints:
        scenarios += [*_releases(joint), *_drives(joint)]
    return scenarios


def _falls(options: VerifyOptions) -> list[Scenario]:
    """Return free falls: from a small height, from a greater one, and tilted about x and y."""
    lean = float(np.radians(options.drop_tilt_deg))
    low, high = options.drop_height_m, options.high_drop_m
    return [
        Scenario("free_fall", "fall", "free", height=low),
        Scenario("free_fall", "fall_high", "free", height=high),
        Scenario("free_fall", "fall_tilted_x", "free", height=low, tilt=(lean, 0.0)),
        Scenario("free_fall", "fall_tilted_y", "free", height=low, tilt=(0.0, lean)),
    ]


def _pushes(parts: list[str], options: VerifyOptions) -> list[Scenario]:
    """Return force perturbations: pushes in six directions and a twist on each part."""
    speed = options.impulse_ns_per_kg
    scenarios = []
    for part in parts:
        push = Scenario("force_perturbation", f"push:{part}:", "free", height=1e-4, part=part)
        for name, (x, y, z) in DIRECTIONS.items():
            impulse = (speed * x, speed * y, speed * z)
            scenarios.append(replace(push, name=push.name + name, impulse=impulse))
        scenarios.append(replace(push, name=f"{push.name}twist", twist=3 * speed))
    return scenarios


def _releases(joint: SingleJoint) -> list[Scenario]:
    """Return releases of a joint: at both limits and the middle, weightless, and coasting."""
    middle = (joint.low + joint.high) / 2
    # Without losses the coasting joint reaches the end of its range in one second.
    speed = (joint.high - joint.low) / 2
    runs: list[tuple[str, World, float, dict[str, float]]] = [
        (f"release:{joint.name}:low", "held", joint.low, {}),
        (f"release:{joint.name}:middle", "held", middle, {}),
        (f"release:{joint.name}:high", "held", joint.high, {}),
        (f"still:{joint.name}", "weightless", middle, {}),
        (f"coast:{joint.name}", "weightless", middle, {joint.name: speed}),
    ]
    return [
        Scenario(
            "joint_release", name, world, joint=joint.name, speeds=speeds,
            joints={**joint.opened, joint.name: position}, propped=frozenset(joint.opened),
        )
        for name, world, position, speeds in runs
    ]  # fmt: skip


def _drives(joint: SingleJoint) -> list[Scenario]:
    """Return drives of a joint up its range and down again, without and with gravity."""
    worlds: dict[str, World] = {"drive": "weightless", "drive_loaded": "held"}
    return [
        Scenario(
            "joint_drive", f"{name}:{joint.name}", world, joint=joint.name, driven=True,
            joints={**joint.opened, joint.name: joint.low}, propped=frozenset(joint.opened),
        )
        for name, world in worlds.items()
    ]  # fmt: skip


def slope_at(time: NDArray, duration: float) -> NDArray:
    """Return the angle of the ground [t] rad at times [t] s of a run of length `duration` [s]."""
    share = np.clip((time - TILT_FROM_S) / (duration - TILT_FROM_S), 0.0, 1.0)
    return np.radians(STEEPEST_DEG) * share
