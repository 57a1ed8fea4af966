"""Resting poses on level ground: the tilt nearest to a parsed one at which an object is stable.

Parsed tilts are approximate. For example, if a mushroom were tipped by exactly 90 degrees, its stem
would float, because the cap is thicker. The search does not change tilts, so composition descends
from the parsed tilt to a local minimum of the height of the center of mass.

Dry friction that holds joints at their parsed positions against gravity.

Friction holds a half-open part at rest. The friction in a program may be too small at the parsed
size and opening. The joint then moves in every rollout, whatever the layout is.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from ..errors import SpecError
from ..physics.colliders import start_state
from ..physics.placed import BALL_EXTENT
from ..physics.sampling import HULL_DIRECTIONS
from ..spec import (
    JointSpec,
    ObjectSpec,
    Quat,
    SceneObject,
    SceneSpec,
    SceneTree,
    TreeNode,
    bounds,
    inertial,
    joint_position,
    link_poses,
    pieces,
)
from ..spec.convex import sphere_directions, support_points
from ..spec.pose import IDENTITY, conjugate, from_axis_angle, quat_mul, rotate

MAX_TILT_RAD = np.radians(30.0)
"""Largest change of the tilt [rad]. If a larger change is needed, the object has another support,
or the parse is wrong."""
STABLE_DROP_M = 1e-7
"""Drop of the center of mass by a tilt up to which an object counts as stable [m]. The drop of a
ball is zero."""
_FIRST_STEP_RAD, _LAST_STEP_RAD = np.radians(4.0), np.radians(0.01)


def resting_tilt(spec: ObjectSpec, state: dict[str, float], tilt: Quat) -> Quat | None:
    """Return the tilt nearest to a given tilt at which an object rests on level ground.

    Args:
        spec: the object.
        state: joint positions.
        tilt: parsed tilt, the rotation that is applied before the yaw.

    Returns:
        The tilt, or None if there is no resting pose within 30 degrees. A ball may turn farther:
        its tilt is not seen, but an almost round one rolls until it rests.
    """
    lowest = _lowest_points(spec, state)
    parsed = rotate(conjugate(np.array(tilt)), np.array([0.0, 0.0, -1.0]))
    down, step = parsed, _FIRST_STEP_RAD
    ball = False
    if np.ptp(size := np.subtract(*bounds(spec, state)[::-1])) < BALL_EXTENT * size.max():
        directions = sphere_directions(HULL_DIRECTIONS)
        heights = np.array([float((lowest(d) @ d).max()) for d in directions])
        ball = bool(np.ptp(heights) < BALL_EXTENT * size.max())  # A cube is none.
        down = directions[int(np.argmin(heights))] if ball else down
    best_height = float((lowest(down) @ down).max())
    known_points = np.vstack(
        [lowest(direction) for direction in (down, *_tilted_directions(down, step))]
    )
    while step > _LAST_STEP_RAD:
        direction, predicted = _lower(known_points, down, step)
        points = lowest(direction)
        known_points = np.vstack([known_points, points])
        height = float((points @ direction).max())
        if best_height - height > max(0.5 * (best_height - predicted), 1e-9):
            down, best_height = direction, height
        else:
            step *= 0.85  # The new points have extended the linear model.
        if not ball and down @ parsed < np.cos(MAX_TILT_RAD):
            return None
    return _rotate_tilt(tilt, down, parsed)


def is_stable_upright(spec: ObjectSpec, state: dict[str, float]) -> bool:
    """Return whether no small tilt lowers an upright object's center of mass, so it stays upright.

    The condition is sufficient, but not necessary: an object on a narrow foot may be stable
    although a tilt by the tested angle lowers its center of mass; see `resting_tilt`.
    """
    lowest, down = _lowest_points(spec, state), np.array([0.0, 0.0, -1.0])
    lowest_height = float((lowest(down) @ down).max()) - STABLE_DROP_M
    sides = _tilted_directions(down, _FIRST_STEP_RAD)
    sides += [(a + b) / np.linalg.norm(a + b) for a in sides[:2] for b in sides[2:]]
    return all(float((lowest(side) @ side).max()) >= lowest_height for side in sides)


def _lowest_points(spec: ObjectSpec, state: dict[str, float]) -> Callable[[NDArray], NDArray]:
    """Return a function that maps a unit vector to the farthest point of each piece along it.

    The points are relative to the center of mass [m], shape [n, 3].

    """
    links = link_poses(spec, state)
    posed_pieces = [
        (piece, links[part.name].then(frame))
        for part in spec.parts
        for _, piece, frame in pieces(part)
    ]
    bodies = [(inertial(spec, part), links[part.name]) for part in spec.parts]
    masses = [inertia.mass for inertia, _ in bodies]
    center = np.average(
        [frame.apply(inertia.pos) for inertia, frame in bodies], axis=0, weights=masses
    )

    def lowest(down: NDArray) -> NDArray:
        points = [
            frame.apply(support_points(piece, rotate(conjugate(frame.quat), down[None])))
            for piece, frame in posed_pieces
        ]
        return np.concatenate(points) - center

    return lowest


def on_level(node: TreeNode, tree: SceneTree) -> bool:
    """Return whether an object is on level ground, an environment support built from its 3D box."""
    supported = node.parent is not None and tree.node(node.parent).slab
    return supported and node.relation == "on"


def pose_without_scene(node: TreeNode, spec: ObjectSpec, *, level: bool) -> tuple[Quat, bool]:
    """Return the tilt at which to verify an object without its scene, on level ground.

    A lying object is verified in its resting pose. Some objects depend on their scene and would
    fall without it: objects that lean or hang, objects that are tilted on a support that is not
    level, and objects that are in a container and cannot stand on their own.

    Args:
        node: the object, as parsed.
        spec: the object.
        level: True if the object is on level ground in its scene.

    Returns:
        The tilt, and True if the object depends on its scene.
    """
    tilt = node.base_tilt
    if node.environment or node.fastened or node.relation in ("leaning", "attached"):
        return tilt, True
    upright = np.allclose(tilt, IDENTITY)
    if upright and (node.relation != "in" or is_stable_upright(spec, {})):
        return tilt, False
    rest_tilt = resting_tilt(spec, {}, tilt)
    if upright:
        return tilt, rest_tilt is None
    return (tilt, not level) if rest_tilt is None else (rest_tilt, False)


def _tilted_directions(down: NDArray, step: float) -> list[NDArray]:
    """Return four unit vectors that are tilted from `down` in four directions."""
    tangents = np.linalg.svd(down[None])[2][1:]
    return [(down + side) / np.hypot(1.0, step) for side in step * np.vstack([tangents, -tangents])]


def _lower(points: NDArray, down: NDArray, step: float) -> tuple[NDArray, float]:
    """Find the unit vector within `step` of `down` with the smallest largest projection of points.

    The extent is a maximum of linear functions, so it is not smooth. A linear program minimizes it.

    Returns:
        The unit vector, and the extent along it [m].
    """
    tangents = np.linalg.svd(down[None])[2][1:]
    solution = linprog(
        [0.0, 0.0, 1.0],
        A_ub=np.column_stack([points @ tangents.T, -np.ones(len(points))]),
        b_ub=-points @ down,
        bounds=[(-step, step), (-step, step), (None, None)],
    )
    direction = down + solution.x[:2] @ tangents
    direction /= np.linalg.norm(direction)
    return direction, float((points @ direction).max())


def _rotate_tilt(tilt: Quat, normal: NDArray, down: NDArray) -> Quat:
    """Compose a tilt with the smallest rotation that takes `normal` to `down`."""
    axis = np.cross(normal, down)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        return tilt
    rotation = from_axis_angle(axis / sine, float(np.arctan2(sine, normal @ down)))
    quat = quat_mul(np.array(tilt), rotation)
    return tuple((quat / np.linalg.norm(quat)).tolist())


MARGIN = 1.5
"""Ratio of the raised friction to the load."""
AT_LIMIT = 1e-3
"""Distance from a limit within which a joint counts as being at the limit [rad or m]."""
NEGLIGIBLE = 1e-9
"""Largest load that counts as zero, because of rounding [N m or N]."""


def hold_joints(obj: SceneObject) -> tuple[SceneObject, dict[str, tuple[float, float]]]:
    """Raise the dry friction of joints that gravity would move from their composed positions.

    Joints with springs, ball joints and mimic joints do not change. The load of a mimic joint acts
    on the joint that it follows.

    Args:
        obj: an object in its composed orientation.

    Returns:
        The object, and the friction of each changed joint before and after [N m or N].

    Raises:
        SpecError: MuJoCo cannot compile the object.
    """
    joints = [j for j in obj.spec.joints if j.type != "fixed"]
    if not joints:
        return obj, {}
    loads = joint_loads(obj)
    changes: dict[str, tuple[float, float]] = {}
    for joint in joints:
        load = loads[joint.name]
        free = joint.type != "ball" and joint.mimic is None and joint.stiffness == 0
        if not free or abs(load) < NEGLIGIBLE or _blocked(obj, joint, load):
            continue
        if joint.friction < MARGIN * abs(load):
            changes[joint.name] = joint.friction, MARGIN * abs(load)
    if not changes:
        return obj, {}
    held_joints = tuple(
        j.model_copy(update={"friction": changes[j.name][1]}) if j.name in changes else j
        for j in obj.spec.joints
    )
    spec = obj.spec.model_copy(update={"joints": held_joints})
    return obj.model_copy(update={"spec": spec}), changes


def with_joint_friction(obj: SceneObject, notes: list[str]) -> SceneObject:
    """Return an object with enough friction to hold its joints; append a note for each change."""
    holding, changes = hold_joints(obj)
    for joint, (before, after) in changes.items():
        unit = "N" if obj.spec.joint(joint).type == "prismatic" else "N m"
        notes.append(
            f"{obj.name}: composition raised the dry friction of joint {joint} from {before:.2g} "
            f"to {after:.2g} {unit}, because gravity would move it from its parsed position"
        )
    return holding


def joint_loads(obj: SceneObject) -> dict[str, float]:
    """Return the gravity load of each movable joint, without springs [N m or N].

    Positive loads move a joint toward its upper limit. The load of a mimic joint is added to the
    joint that it follows. The load of a ball joint is 0.
    """
    as_root = {"parent": None, "parent_link": None, "relation": "on", "environment": True}
    alone = SceneSpec(name="held", objects=(obj.model_copy(update=as_root),))
    try:
        model, data = start_state(alone)
    except ValueError as error:
        raise SpecError(f"{obj.name}: {error}") from None
    moving = [joint for joint in obj.spec.joints if joint.type != "fixed"]
    loads = dict.fromkeys((joint.name for joint in moving), 0.0)
    for joint in moving:
        if joint.type == "ball":
            continue
        address = int(model.joint(f"{obj.name}-{joint.name}").dofadr[0])
        leader, ratio = joint, 1.0
        while leader.mimic is not None:
            ratio *= leader.mimic.multiplier
            leader = obj.spec.joint(leader.mimic.joint)
        loads[leader.name] -= ratio * float(data.qfrc_bias[address])
    return loads


def _blocked(obj: SceneObject, joint: JointSpec, load: float) -> bool:
    """Return whether a joint is at the limit that its load pushes against."""
    if joint.type == "continuous":
        return False
    value = joint_position(obj.spec, joint, obj.joint_state)
    assert not isinstance(value, tuple)
    return value > joint.upper - AT_LIMIT if load > 0 else value < joint.lower + AT_LIMIT
