"""Execution of plans in MuJoCo, and evaluation of predicates."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from neoworld_mjx.environments.predicates import Predicate
from neoworld_mjx.spec import SceneSpec
from neoworld_mjx.spec.pose import quat_mul, rotate

from .plan_format import TaskPlan, ToolMove, rotation
from .world import TIMESTEP, World, in_start_axes

CONTROL_S = 0.01
"""Time between targets and between evaluated states [s]."""
SETTLE_S = 1.0
"""Time from the end of the plan to the evaluated interval [s]."""
HOLD_S = 1.0
"""Duration for which a predicate must hold [s]."""
START_DEPTH_M = 0.001
"""Maximum initial penetration of the gripper [m]: the bound of S-Pen."""

Watch = Callable[[World, float], None]


@dataclass(frozen=True)
class Outcome:
    """Outcome of a plan."""

    success: bool
    reason: str
    """Reason of a failure; empty on success."""
    progress: float
    """Closeness of the final state to success, in [0, 1]."""
    held: float
    """Share of the states of the last second that fulfil the predicate."""
    seconds: float = 0.0
    """Simulated time [s]."""


def execute(
    scene: SceneSpec,
    plan: TaskPlan,
    predicate: Predicate,
    *,
    watch: Watch | None = None,
    visual: bool = False,
) -> Outcome:
    """Simulate a plan and evaluate the predicate over the last second.

    Args:
        scene: the scene in its composed state.
        plan: what the gripper does; it then stays where it is.
        predicate: what must hold in every state of the last HOLD_S.
        watch: called with the world and the time [s] every CONTROL_S.
        visual: whether the model that `watch` sees has smooth geoms, for pictures.

    Returns:
        The outcome; a plan that starts inside an object, or a simulation that diverges, fails.
    """
    world = World(scene, plan, visual=visual)
    depth, where = world.depth_of_gripper()
    if depth > START_DEPTH_M:
        reason = f"the gripper starts {1000 * depth:.1f} mm deep in {where}"
        return Outcome(False, reason, float(predicate.progress(world)), 0.0)
    for targets in plan_path(plan):
        _follow(world, plan, targets)
        if watch is not None:
            watch(world, float(world.data.time))
        if world.diverged():
            return Outcome(False, "the simulation diverged", 0.0, 0.0, world.data.time)
    return judge(world, predicate, SETTLE_S, watch)


def judge(
    world: World,
    predicate: Predicate,
    settle: float = SETTLE_S,
    watch: Watch | None = None,
) -> Outcome:
    """Simulate on with the present controls, and evaluate the predicate over the last second.

    Args:
        world: the simulation.
        predicate: what must hold in every state of the last HOLD_S.
        settle: time before [s].
        watch: called with the world and the time [s] every CONTROL_S.
    """
    substeps = round(CONTROL_S / TIMESTEP)
    counts: list[bool] = []
    for k in range(round((settle + HOLD_S) / CONTROL_S)):
        mujoco.mj_step(world.model, world.data, substeps)
        if world.diverged():
            return Outcome(False, "the simulation diverged", 0.0, 0.0, world.data.time)
        if watch is not None:
            watch(world, float(world.data.time))
        if k >= round(settle / CONTROL_S):
            counts.append(bool(predicate.holds(world)))
    held = float(np.mean(counts))
    success = held == 1.0
    reason = "" if success else f"not so for the last second: {predicate.meaning()}"
    progress = float(predicate.progress(world))
    return Outcome(success, reason, progress, held, float(world.data.time))


def plan_path(plan: TaskPlan) -> list[tuple[NDArray, NDArray, float]]:
    """Return the targets every CONTROL_S: displacement [m], rotation since the start, opening
    [m]."""
    path = []
    position, orientation, opening = (
        np.array(plan.position),
        np.array([1.0, 0.0, 0.0, 0.0]),
        plan.opening,
    )
    for move in plan.moves:
        steps = max(1, round(move.seconds / CONTROL_S))
        for k in range(1, steps + 1):
            share = _eased(k / steps)
            place, quat = moved(position, orientation, move, share)
            # Fingers close from the first moment of a move on: 0 is a force, not a place.
            aim = 0.0 if move.opening == 0 else opening + share * (move.opening - opening)
            path.append((place - np.array(plan.position), quat, aim))
        position, orientation = moved(position, orientation, move, 1.0)
        opening = move.opening
    return path


def moved(
    position: NDArray, orientation: NDArray, move: ToolMove, share: float = 1.0
) -> tuple[NDArray, NDArray]:
    """Return the displacement of a point [m] and the rotation after a share of a move."""
    turn = rotation(share * np.array(move.turn))
    pivot = position if move.about is None else np.array(move.about)
    place = pivot + rotate(turn, position - pivot) + share * np.array(move.displacement)
    return place, quat_mul(turn, orientation)


def _eased(x: float) -> float:
    """Return the smooth step 3 x^2 - 2 x^3."""
    return x * x * (3 - 2 * x)


def _follow(world: World, plan: TaskPlan, targets: tuple[NDArray, NDArray, float]) -> None:
    displacement, orientation, opening = targets
    vector = np.zeros(3)
    mujoco.mju_quat2Vel(vector, orientation, 1.0)
    world.command(displacement, in_start_axes(plan, vector), opening)
    mujoco.mj_step(world.model, world.data, round(CONTROL_S / TIMESTEP))
