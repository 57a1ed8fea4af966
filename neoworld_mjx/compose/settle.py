"""Settling of an object on a parent that is not level, such as a spoon on a saucer.

The search does not change tilts. An object at its parsed tilt would turn by some degrees in every
rollout until it rests. This motion would mask other errors of a candidate.

Placement of objects inside containers if their parsed positions overlap the rim.

Rims are about a centimeter wide, but parsed positions are off by some centimeters. If a nested pot,
a tube in a rack or a lid of a jar were snapped at its parsed position, it would stand on the rim.
"""

import itertools
from collections.abc import Iterable, Iterator, Sequence

import jax
import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from ..config import RefineOptions, SettleOptions
from ..physics.layout import Layout, arrange
from ..physics.mjcf import body_name, start_data
from ..physics.model import CompiledScene, compile_for_simulation
from ..physics.rest import rest
from ..physics.sampling import extreme_points
from ..physics.scene_arrays import snapped_heights
from ..spec import SceneObject, SceneSpec, bounds, support_frame, world_poses
from ..spec.kinematics import part_bounds
from ..spec.pose import (
    IDENTITY,
    Pose,
    angle_between,
    conjugate,
    from_yaw,
    pose,
    quat_mul,
    rotate,
    yaw_of,
)
from .resting_pose import MAX_TILT_RAD

GRID_SIZE = 48
"""Number of grid points along each side of a container, for example 2 mm apart over 10 cm."""
MIN_DROP, MIN_DROP_M = 0.1, 0.005
"""Smallest drop, relative to the object's height and [m]. A tilted floor causes smaller drops."""
INSIDE_FRACTION = 0.5
"""Fraction of the largest drop above which a grid point is inside the container."""
EQUAL_HEIGHT_M = 0.002
"""Difference up to which heights count as equal [m]."""
MIN_OUTLINE_DISTANCE = 0.9
"""Smallest distance of a position from the container's outline, relative to half of the object's
width."""
CENTERING_CELLS = 1
"""Neighborhood, in grid spacings, over which a position is centered between walls."""
FOOTPRINT_TOLERANCE = 0.18
"""Largest relative difference between two footprints at which one object may cover the other. The
ratio of two parsed sizes is off by 4 to 5 % (standard deviation)."""


def position_inside(
    parent: SceneObject,
    obj: SceneObject,
    others: Iterable[SceneObject] = (),
    *,
    if_raised: bool = False,
) -> Float[np.ndarray, " 2"] | None:
    """Return the nearest position at which an object stands inside its container.

    Args:
        parent: the container.
        obj: an object in the container, or a lid on it; assumed to be upright.
        others: objects already in the container, which the result avoids.
        if_raised: if True, an object moves only if snapping at its parsed position would raise it,
            such as onto the rim.

    Returns:
        The position [m] in the frame of `SceneObject.xy`; None if the object is not lower at any
        other position, or need not move.
    """
    root = {"parent": None, "parent_link": None, "environment": True, "xy": (0.0, 0.0)}
    base = parent.model_copy(update={**root, "z": 0.0, "yaw": 0.0})
    upright = obj.model_copy(update={"base_tilt": IDENTITY})
    scene = SceneSpec(name="inside", objects=(base, upright))
    low, high = _bounds_of(parent, obj.parent_link)
    step = (high - low)[:2] / (GRID_SIZE - 1)
    sides = np.linspace(low[:2], high[:2], GRID_SIZE).T
    grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
    positions = np.concatenate([(low + high)[None, :2] / 2, grid])
    parsed_xy = np.array(obj.xy)
    parsed_height, *heights = _heights(scene, np.concatenate([parsed_xy[None], positions]))
    bottom, top = bounds(obj.spec, obj.joint_state)
    depths = _depths(parent, obj.parent_link, positions)
    reach = min(float((top - bottom)[:2].min()) / 2, float(depths.max()))
    gains = np.where(
        depths > MIN_OUTLINE_DISTANCE * reach, parsed_height - np.array(heights), -np.inf
    )
    for other in others:
        gains[np.linalg.norm(positions - other.xy, axis=1) < _min_separation(obj, other)] = -np.inf
    least = max(MIN_DROP * float(top[2] - bottom[2]), MIN_DROP_M)
    if gains.max() < least or (if_raised and parsed_height - obj.z < least):
        return None
    inside = gains > INSIDE_FRACTION * gains.max()
    nearest = positions[inside][np.linalg.norm(positions[inside] - parsed_xy, axis=1).argmin()]
    nearby = inside & (np.abs(positions - nearest) <= (CENTERING_CELLS + 0.5) * step).all(axis=1)
    nearby &= gains > gains[nearby].max() - EQUAL_HEIGHT_M
    centred = positions[nearby].mean(axis=0)
    fits = parsed_height - _heights(scene, centred[None])[0] > gains[nearby].max() - EQUAL_HEIGHT_M
    return centred if fits else positions[nearby][gains[nearby].argmax()]


def has_same_footprint(parent: SceneObject, obj: SceneObject) -> bool:
    """Return whether an object and its parent have about equal footprints, like a lid and a jar."""
    low, high = _bounds_of(parent, obj.parent_link)
    size = np.sort(np.ptp(bounds(obj.spec, obj.joint_state), axis=0)[:2])
    parent_size = np.sort((high - low)[:2])
    tolerance = FOOTPRINT_TOLERANCE * np.maximum(size, parent_size)
    return bool(np.all(np.abs(size - parent_size) <= tolerance))


def _min_separation(a: SceneObject, b: SceneObject) -> float:
    """Return the distance [m] that the positions of two objects in a container must keep."""
    widths = [np.ptp(bounds(o.spec, o.joint_state), axis=0)[:2].min() for o in (a, b)]
    return float(sum(widths)) / 4


def _bounds_of(parent: SceneObject, link: str | None) -> Float[np.ndarray, "2 3"]:
    if link is None:
        return np.array(bounds(parent.spec, parent.joint_state))
    return np.array(part_bounds(parent.spec, parent.spec.part(link)))


def _depths(
    parent: SceneObject, link: str | None, positions: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Return the distances [m] of positions from a container's outline; positive inside it."""
    if link is not None:
        low, high = _bounds_of(parent, link)
        return np.minimum(positions - low[:2], high[:2] - positions).min(axis=1)
    sides = ConvexHull(extreme_points(parent)[:, :2]).equations
    return -(positions @ sides[:, :2].T + sides[:, 2]).max(axis=1)


def _heights(scene: SceneSpec, positions: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """Return the heights [m] at which the second object of a scene stands at each position."""
    layout = Layout.zero(len(positions), 2)
    xy = np.zeros((len(positions), 2, 2), np.float32)
    xy[:, 1] = positions - scene.objects[1].xy
    return snapped_heights(arrange(scene), Layout(xy, layout.yaw, layout.log_scale))[:, 1]


HOLD = SettleOptions(rate=3.0, duration_s=2.5)
"""Soft springs, under which an object comes down and may tip and slide, but does not bounce."""
FREE_S = 0.3
"""Duration of the free fall in which an object must stay at rest [s]."""
STILL = 0.5
"""Largest motion in the free fall, relative to the bounds of the final check."""
MAX_PENETRATION_M, LIFT_M = 1e-4, 0.002
MAX_SHIFT, MAX_SHIFT_INSIDE = 0.25, 1.0
"""Largest horizontal shift relative to the object's diagonal, outside and inside a container. It is
larger in a container, because the object must enter the container."""
DROP_FRACTIONS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Fractions of the offset to a container's center by which an object is moved before it is
dropped."""
SOLE_M = 0.002
"""Height above an object's lowest point up to which points count as lowest points [m]."""
SHIFT_COST = 0.2
"""Cost of a horizontal shift of the resting pose, as a height per distance."""


def settle(
    parent: SceneObject, obj: SceneObject, others: Iterable[SceneObject] = ()
) -> SceneObject | None:
    """Settle an object on or in its parent; see `rest`.

    At its parsed position, an object in a container may penetrate the container's wall, and would
    settle on the rim. Therefore, it is also dropped with its lowest points nearer to the center,
    and from a position where it would stand upright inside. The resting pose with the lowest cost
    is returned. The cost depends on the height, the change of tilt and the horizontal shift.

    Args:
        parent: the parent, which does not move.
        obj: the object; it is first lifted until it touches nothing.
        others: objects already in the container, see `position_inside`; they are not simulated.

    Returns:
        The object with the heading, tilt and position of its resting pose. None if there is no
        resting pose within 30 degrees and a horizontal shift of a quarter of the object's diagonal,
        or of the whole diagonal in a container.

    Raises:
        SpecError: MuJoCo cannot compile the two objects.
    """
    as_root = {"parent": None, "parent_link": None, "environment": True, "xy": (0.0, 0.0)}
    base = parent.model_copy(update={**as_root, "z": 0.0, "yaw": 0.0})
    scene = SceneSpec(name=f"{obj.name}_on_{parent.name}", objects=(base, obj))
    world = compile_for_simulation(scene)
    model, root = world.static.mjm, int(world.static.root[1])
    size = float(np.linalg.norm(np.subtract(*bounds(obj.spec, obj.joint_state, obj.base_tilt))))
    poses = world_poses(scene)
    frame = support_frame(base, poses[base.name], obj.parent_link)
    start = frame.inverse().then(poses[obj.name])
    best, least_cost = None, np.inf
    container = body_name(base, obj.parent_link or base.spec.root)
    parsed_quat = poses[obj.name].quat
    drops = [(shift, parsed_quat) for shift in _shifts(model, root, obj, model.body(container).id)]
    tilt = float(angle_between(obj.base_tilt, IDENTITY))
    position = (
        position_inside(parent, obj, others)
        if obj.relation == "in" and tilt < MAX_TILT_RAD
        else None
    )
    if position is not None:
        # The object fits into a narrow hole only if it is upright.
        upright = quat_mul(frame.quat, from_yaw(obj.yaw))
        drops.append((rotate(frame.quat, [*np.subtract(position, obj.xy), 0.0])[:2], upright))
    for end, height in _drop(world, drops, size):
        settled = _settled_object(obj, frame.inverse().then(end), start, size)
        if settled is None:
            continue
        # The tilt term penalizes an object that got stuck on the rim.
        cost = height + size / 2 * float(angle_between(obj.base_tilt, settled.base_tilt))
        cost += SHIFT_COST * float(np.hypot(*np.subtract(settled.xy, obj.xy)))
        if cost < least_cost:
            best, least_cost = settled, cost
    return best


def _shifts(model: mujoco.MjModel, body: int, obj: SceneObject, container: int) -> list[NDArray]:
    """Return the horizontal shifts [m] from the parsed position from which an object is dropped."""
    if obj.relation != "in":
        return [np.zeros(2)]
    data = start_data(model)
    mujoco.mj_forward(model, data)
    corners = _corners(model, data, container)
    object_corners = _corners(model, data, body)
    center = (corners.min(axis=0) + corners.max(axis=0))[:2] / 2
    sole = object_corners[object_corners[:, 2] < object_corners[:, 2].min() + SOLE_M]
    offset = center - sole.mean(axis=0)[:2]
    return [fraction * offset for fraction in DROP_FRACTIONS]


def _corners(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> NDArray:
    """Return the corners of the collision geoms' boxes in a body's subtree, in the world frame."""
    ids = np.arange(model.nbody)
    parts = ids == body
    for child in ids[body + 1 :]:
        parts[child] |= parts[model.body_parentid[child]]
    geoms = np.flatnonzero(parts[model.geom_bodyid] & (model.geom_contype > 0))
    sides = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    box = model.geom_aabb[geoms]
    local = box[:, None, :3] + sides * box[:, None, 3:]
    rotation = data.geom_xmat[geoms].reshape(-1, 1, 3, 3)
    return (data.geom_xpos[geoms][:, None] + np.einsum("gkij,gkj->gki", rotation, local)).reshape(
        -1, 3
    )


def _drop(
    world: CompiledScene, drops: Sequence[tuple[NDArray, NDArray]], size: float
) -> Iterator[tuple[Pose, float]]:
    """Settle the second object of a scene from some shifts and rotations.

    Yield each pose at which it rests, and the height of its center of mass there [m].
    """
    model, body = world.static.mjm, int(world.static.root[1])
    qpos = model.jnt_qposadr[model.body_jntadr[body]] + np.arange(7)
    data, lifted = mujoco.MjData(model), []
    for shift, quat in drops:
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.qpos[qpos[:2]] += shift
        data.qpos[qpos[3:]] = quat
        if _lift_free(model, data, body, size):
            lifted.append(data.qpos[qpos].copy())
    if not lifted:
        return
    mujoco.mj_forward(model, data)
    center = pose(data.xpos[body], data.xquat[body]).inverse().apply(data.subtree_com[body])
    starts = jax.tree.map(lambda x: np.repeat(x, len(lifted), axis=0), world.poses())
    starts.pos[:, 1], starts.quat[:, 1] = np.split(np.array(lifted), [3], axis=1)
    rested = rest(world, starts, hold=HOLD, free_s=FREE_S)
    pos, quat = (np.asarray(x)[:, 1] for x in (rested.poses.pos, rested.poses.quat))
    o = RefineOptions()
    moved = np.maximum(rested.drift / o.max_drift_m, rested.tilt / np.radians(o.max_tilt_deg))
    for k in np.flatnonzero(moved[:, 1] < STILL):
        end = pose(pos[k], quat[k])
        yield end, float(end.apply(center)[2])


def _settled_object(obj: SceneObject, end: Pose, start: Pose, size: float) -> SceneObject | None:
    """Return an object at its resting pose, or None if that is too far from the parsed pose.

    Args:
        obj: the object.
        end: resting pose in the parent's frame.
        start: parsed pose in the parent's frame.
        size: diagonal of the object [m].
    """
    heading = yaw_of(quat_mul(end.quat, conjugate(start.quat)))
    tilt = quat_mul(conjugate(from_yaw(obj.yaw + heading)), end.quat)
    shift = float(np.linalg.norm(end.pos[:2] - np.array(obj.xy)))
    limit = MAX_SHIFT_INSIDE if obj.relation == "in" else MAX_SHIFT
    if angle_between(obj.base_tilt, tilt) > MAX_TILT_RAD or shift > limit * size:
        return None
    return obj.model_copy(
        update={
            "xy": tuple(end.pos[:2].tolist()),
            "z": float(end.pos[2]),
            "yaw": obj.yaw + heading,
            "base_tilt": tuple((tilt / np.linalg.norm(tilt)).tolist()),
        }
    )


def _lift_free(model: mujoco.MjModel, data: mujoco.MjData, body: int, limit: float) -> bool:
    """Lift a free body until it penetrates nothing; return False if that exceeds `limit` [m]."""
    height = int(model.jnt_qposadr[model.body_jntadr[body]]) + 2
    tree = model.body_rootid[model.geom_bodyid]
    for _ in range(round(limit / LIFT_M) + 1):
        mujoco.mj_forward(model, data)
        # Contacts between parts of the parent do not count.
        touches = np.count_nonzero(tree[data.contact.geom] == body, axis=1) == 1
        if not np.any(data.contact.dist[touches] < -MAX_PENETRATION_M):
            return True
        data.qpos[height] += LIFT_M
    return False
