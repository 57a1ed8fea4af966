"""Script of a robot's motion: to the point of a task, and on to its goal."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..spec.pose import Pose, length
from .arm import SceneState
from .policy_environment import Script
from .predicates import Located
from .reach import reachable
from .robots import Mount, Robot
from .task import SceneTask, StateView

STEP_M = 0.012
"""Distance of the tool from one pose of the script to the next [m]."""
WAIT = 8
"""Actions for the fingers to close or to open."""
CLEAR_M = 0.08
"""Height above the straight way to a goal at which an object is carried [m]."""


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
        high = [Pose(p.pos + (0.0, 0.0, CLEAR_M), p.quat) for p in (at, onward[-1])]
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


def _way(poses: list[Pose], grip: float) -> list[tuple[Pose, float]]:
    """Return poses along straight lines, at most `STEP_M` from each other."""
    rows = []
    for a, b in zip(poses[:-1], poses[1:], strict=True):
        count = max(1, int(np.ceil(float(length(b.pos - a.pos, np)) / STEP_M)))
        for share in np.linspace(0.0, 1.0, count + 1)[1:]:
            quat = a.quat + share * (b.quat * np.sign(a.quat @ b.quat or 1.0) - a.quat)
            rows.append((Pose(a.pos + share * (b.pos - a.pos), quat / np.linalg.norm(quat)), grip))
    return rows
