"""Script of a robot's motion: to the point of a task, and on to its goal."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from ..physics.mjcf import body_name
from ..spec import world_bounds, world_poses
from ..spec.pose import Pose, length
from .arm import SceneState
from .policy_environment import Script
from .predicates import Located
from .reach import NOT_ROBOT, reachable
from .robots import Mount, Robot
from .task import SceneTask, StateView

STEP_M = 0.012
"""Distance of the tool from one pose of the script to the next [m]."""
WAIT = 8
"""Actions for the fingers to close or to open."""
CLEAR_M = (0.08, 0.12, 0.16, 0.2, 0.25, 0.3)
"""Heights above the straight way to a goal at which an object is carried: the lowest at which
nothing is in its way, or the lowest of all [m]."""
BESIDE_M = (-0.03, 0.0, 0.03)
"""Distances from the middle of this way at which it must be free [m]."""


def arm_script(task: SceneTask, robot: Robot | Path | str, mount: Mount) -> Script | None:
    """Return a motion that works on the task's point and moves to the goal; None out of reach.

    The tool takes the object at its initial place in each episode, and brings it to where the goal
    is in this episode. A placed object is lifted, carried, lowered and let go. The motion need not
    succeed.
    """
    arm, reach = task.controlled.arm, reachable(task.task, robot, mount)
    if arm is None or not reach.reaches:
        return None
    before, at, *onward = reach.path
    closes, goal = task.task.point.grasp, task.task.goal
    grip = -1.0 if closes else 0.0
    opened = 1.0 if closes else grip
    # The tool lags behind, so it waits before the fingers move.
    rows = _way([before, at], opened) + [(at, opened)] * WAIT + [(at, grip)] * WAIT
    if onward and isinstance(goal, Located) and goal.released and closes:
        clear = _clearance(task, at.pos, onward[-1].pos)
        high = [Pose(p.pos + (0.0, 0.0, clear), p.quat) for p in (at, onward[-1])]
        rows += _way([at, *high, onward[-1]], grip) + [(onward[-1], grip)] * WAIT
        rows += [(onward[-1], 1.0)] * WAIT
        rows += _way([onward[-1], high[-1]], 1.0)
    else:
        rows += _way([at, *onward], grip) + [((onward or [at])[-1], grip)] * WAIT
    pos = jnp.asarray(np.array([p.pos for p, _ in rows]), jnp.float32)
    quat = jnp.asarray(np.array([p.quat for p, _ in rows]), jnp.float32)
    fingers = jnp.asarray([value for _, value in rows], jnp.float32)
    way = (onward or [at])[-1].pos[:2] - at.pos[:2]
    done = jnp.clip((pos[:, :2] - at.pos[:2]) @ way / max(way @ way, 1e-9), 0.0, 1.0)

    def ends(state: SceneState) -> tuple[Any, Any]:
        """Return where the motion takes the object or part, and where it brings an object [m]."""
        view = StateView(task.controlled, state)
        point = view.point(task.task.point)
        return point, goal.aim(view) if isinstance(goal, Located) else point

    nominal = [end.astype(np.float32) for end in ends(task.initial_state)]

    def action(state: SceneState, first: SceneState, t: jax.Array) -> jax.Array:
        start, end = (now - then for now, then in zip(ends(first), nominal, strict=True))
        shift = start + done[t] * (end - start)
        return arm.toward(state, pos[t] + shift, quat[t], fingers[t], jnp)

    return Script(action, len(rows))


def _clearance(task: SceneTask, start: NDArray, end: NDArray) -> float:
    """Return the height above a way of the tool at which it carries an object over all others [m].

    Rays along the way at the object's foot must not meet anything before its end.
    """
    way = end - start
    if np.linalg.norm(way) < 1e-6:  # a ray needs a direction
        return CLEAR_M[0]
    model, data = task.controlled.model, task.controlled.initial_data()
    item = task.task.scene.object(task.task.point.object)
    foot = world_bounds(item, world_poses(task.task.scene)[item.name])[0][2]
    own, hit = model.body(body_name(item, item.spec.root)).id, np.zeros(1, np.int32)
    across = np.cross(way, (0.0, 0.0, 1.0)) / max(float(np.linalg.norm(way[:2])), 1e-9)
    for clear in CLEAR_M:
        starts = [(*(start + side * across)[:2], foot + clear) for side in BESIDE_M]
        rays = [mujoco.mj_ray(model, data, x, way, NOT_ROBOT, 1, own, hit) for x in starts]
        if not any(0.0 <= share <= 1.0 for share in rays):
            return clear
    return CLEAR_M[0]


def _way(poses: list[Pose], grip: float) -> list[tuple[Pose, float]]:
    """Return poses along straight lines, at most `STEP_M` from each other."""
    rows = []
    for a, b in zip(poses[:-1], poses[1:], strict=True):
        count = max(1, int(np.ceil(float(length(b.pos - a.pos, np)) / STEP_M)))
        for share in np.linspace(0.0, 1.0, count + 1)[1:]:
            quat = a.quat + share * (b.quat * np.sign(a.quat @ b.quat or 1.0) - a.quat)
            rows.append((Pose(a.pos + share * (b.pos - a.pos), quat / np.linalg.norm(quat)), grip))
    return rows
