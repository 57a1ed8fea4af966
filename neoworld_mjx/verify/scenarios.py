"""Scenarios of an object: falls, pushes, releases, drives and a slope.

A scenario says how the object starts and which forces act on it when; `Simulation.run` runs all
scenarios of an object in one batch. The paper's two standard scenarios (Section 3.2, Step 3) are
presets by name.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..config import VerifyOptions
from .verdict import ScenarioKind

World = Literal["free", "gripping", "held", "weightless"]
"""Free on the floor; the same with contacts that do not creep; its base held fast, without floor;
held, and without gravity too."""
SINGLE = ("revolute", "continuous", "prismatic")
"""Types of joints with one value; what has three is posed and pushed, but not driven."""
STILL_S = 0.1
"""Time a joint rests before it is driven."""
TILT_FROM_S, STEEPEST_DEG = 0.3, 70.0
"""When the slope begins to rise, and how steep it is at the end."""
DIRECTIONS = {
    "+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1),
    "-z": (0, 0, -1),
}  # fmt: skip


_DRIVES: tuple[tuple[str, World], ...] = (("drive", "weightless"), ("drive_loaded", "held"))


@dataclass(frozen=True)
class Scenario:
    """One scenario of an object."""

    kind: ScenarioKind
    name: str
    world: World
    height: float = 0.0
    """Of its lowest point above the floor at the start [m]."""
    tilt: tuple[float, float] = (0.0, 0.0)
    """Turn at the start about x and about y, on top of how it rests [rad]."""
    joints: dict[str, float] = field(default_factory=dict)
    """Where joints start [rad or m]."""
    propped: frozenset[str] = frozenset()
    """Joints that are kept where they start: the door of a rack that is moved."""
    speeds: dict[str, float] = field(default_factory=dict)
    """How fast they start."""
    part: str | None = None
    """What is pushed."""
    impulse: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Over the mass pushed [m/s]."""
    twist: float = 0.0
    """Turn about the vertical that the push gives the pushed mass, alone [rad/s]."""
    joint: str | None = None
    """What is released or driven."""
    driven: bool = False
    slope: bool = False


@dataclass(frozen=True)
class Moving:
    """What scenarios need to know of a joint that moves by itself."""

    name: str
    child: str
    low: float
    high: float
    """Its range [rad or m]; one turn for a continuous joint."""
    sprung: bool = False
    opened: dict[str, float] = field(default_factory=dict)
    """Where the joints stand that it waits for [rad or m]."""

    @property
    def middle(self) -> float:
        """The middle of its range."""
        return (self.low + self.high) / 2


def list_scenarios(
    parts: list[str], joints: list[Moving], options: VerifyOptions, *, fixed_base: bool
) -> list[Scenario]:
    """List what is done to an object.

    Args:
        parts: one of each group of parts that move together, the root first.
        joints: those that move by themselves.
        options: heights, impulses.
        fixed_base: whether the base stays fastened; then only joints are tried.
    """
    scenarios = [] if fixed_base else [*falls(options), *pushes(parts, options), slope()]
    for joint in joints:
        scenarios += releases(joint)
        scenarios += drives(joint)
    return scenarios


def falls(options: VerifyOptions) -> list[Scenario]:
    """Free fall from a small height, a higher one, and tilted about either axis."""
    lean = np.radians(options.drop_tilt_deg)
    low, high = options.drop_height_m, options.high_drop_m
    return [
        Scenario("free_fall", "fall", "free", height=low),
        Scenario("free_fall", "fall_high", "free", height=high),
        Scenario("free_fall", "fall_tilted_x", "free", height=low, tilt=(float(lean), 0.0)),
        Scenario("free_fall", "fall_tilted_y", "free", height=low, tilt=(0.0, float(lean))),
    ]


def pushes(parts: list[str], options: VerifyOptions) -> list[Scenario]:
    """Force perturbation: six directions and a twist on each part."""
    speed = options.impulse_ns_per_kg
    scenarios = []
    for part in parts:
        for name, direction in DIRECTIONS.items():
            x, y, z = (speed * d for d in direction)
            scenarios.append(
                Scenario(
                    "force_perturbation", f"push:{part}:{name}", "free", height=1e-4, part=part,
                    impulse=(x, y, z),
                )
            )  # fmt: skip
        name = f"push:{part}:twist"
        scenarios.append(
            Scenario("force_perturbation", name, "free", height=1e-4, part=part, twist=3 * speed)
        )
    return scenarios


def releases(joint: Moving) -> list[Scenario]:
    """Let a joint go from low, middle and high, leave it alone without weight, and let it coast."""
    scenarios = [
        Scenario(
            "joint_release", f"release:{joint.name}:{where}", "held", joint=joint.name,
            joints={**joint.opened, joint.name: value}, propped=frozenset(joint.opened),
        )
        for where, value in (("low", joint.low), ("middle", joint.middle), ("high", joint.high))
    ]  # fmt: skip
    middle = {**joint.opened, joint.name: joint.middle}
    propped = frozenset(joint.opened)
    scenarios.append(
        Scenario(
            "joint_release", f"still:{joint.name}", "weightless", joints=middle, joint=joint.name,
            propped=propped,
        )
    )  # fmt: skip
    # Without losses it would take a second to the end of its range.
    speed = {joint.name: (joint.high - joint.low) / 2}
    scenarios.append(
        Scenario(
            "joint_release", f"coast:{joint.name}", "weightless", joints=middle, speeds=speed,
            joint=joint.name, propped=propped,
        )
    )  # fmt: skip
    return scenarios


def drives(joint: Moving) -> list[Scenario]:
    """Drive a joint up its range and down again, with and without gravity."""
    return [
        Scenario(
            "joint_drive", f"{name}:{joint.name}", world, joint=joint.name, driven=True,
            joints={**joint.opened, joint.name: joint.low}, propped=frozenset(joint.opened),
        )
        for name, world in _DRIVES
    ]  # fmt: skip


def slope() -> Scenario:
    """Tilt the ground until the object slides."""
    return Scenario("tilt_until_slide", "slope", "gripping", height=1e-4, slope=True)


def slope_at(time: NDArray, duration: float) -> NDArray:
    """Return the angle of the ground at times [t] s, in rad."""
    share = np.clip((time - TILT_FROM_S) / (duration - TILT_FROM_S), 0.0, 1.0)
    return np.radians(STEEPEST_DEG) * share


PRESETS: dict[str, tuple[str, ...]] = {
    "free_fall": ("fall",),
    "force_perturbation": tuple(f"push:*:{name}" for name in (*DIRECTIONS, "twist")),
}
"""The paper's standard scenarios by the names of those that they stand for; * is any part."""

__all__ = [
    "PRESETS",
    "SINGLE",
    "Moving",
    "Scenario",
    "World",
    "drives",
    "falls",
    "list_scenarios",
    "pushes",
    "releases",
    "slope",
    "slope_at",
]
