"""S_sem by geometry: how well the composed poses agree with the photograph's relations.

The paper's four criteria (Appendix B), each scored per pair of objects in five steps, averaged over
pairs, and the mean of the four taken. The photograph's side is the parsed 2D boxes and depths, seen
through the parsed camera; pixel alignment and viewpoint are not judged.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..physics.layout import Poses, rotation
from ..physics.model import SceneModel
from ..spec import Camera, SceneSpec, bounds, world_poses

LEVELS = 4
"""Steps of a discrete score: 0, 1/4, ... 1."""
SIZE_TOLERANCE = 0.4
"""Difference of log size ratios at which the relative-size score is zero."""
TURN_TOLERANCE = np.radians(45.0)
"""Difference of direction at which the relative-orientation score is zero."""
SEEN_DEPTH = 0.01
"""Penetration [m] at which an intersection is certainly visible."""


class View(NamedTuple):
    """The photograph's side, by object."""

    axes: np.ndarray
    position: np.ndarray
    focal: float
    centre: np.ndarray
    """Middle of each 2D box, relative to the middle of the picture [px], shape [object, 2]."""
    size: np.ndarray
    """Square root of each 2D box's area [px]."""
    depth: np.ndarray
    """Distance along the view [m]."""
    judged: np.ndarray
    """Objects that count: not environment supports."""
    whole: np.ndarray
    """Objects whose 2D box shows all of them."""


def view(scene: SceneSpec) -> View:
    """Collect the photograph's side; what was not parsed is taken from the composed scene."""
    camera = scene.camera or _camera_for(scene)
    middle = np.array([camera.width / 2, camera.height_px / 2])
    poses = world_poses(scene)
    centre, size, depth = [], [], []
    for item in scene.objects:
        low, high = bounds(item.spec, item.joint_state)
        corners = low + (high - low) * _UNIT
        px, away = camera.project(poses[item.name].apply(corners))
        box = [*px.min(axis=0), *px.max(axis=0)]
        if item.box2d is not None:
            box = item.box2d.as_tuple()
        centre.append([(box[0] + box[2]) / 2, (box[1] + box[3]) / 2] - middle)
        size.append(np.sqrt((box[2] - box[0]) * (box[3] - box[1])))
        depth.append(away.mean() if item.depth is None else item.depth)
    return View(
        camera.axes(),
        camera.position(),
        camera.focal,
        np.array(centre),
        np.array(size),
        np.array(depth),
        np.array([not item.environment for item in scene.objects]),
        np.array([not item.occluded for item in scene.objects]),
    )


_UNIT = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)


def _camera_for(scene: SceneSpec) -> Camera:
    far = max(float(np.abs(pose.pos).max()) for pose in world_poses(scene).values())
    return Camera(width=600, height_px=400, fovy=0.8, height=1.0 + far, pitch=0.6)


def semantic_score(
    scene: SceneModel, poses: Poses, depths: Float[Array, "pop object object"]
) -> Float[Array, " pop"]:
    """Score candidates in [0, 1]; a scene without two movable objects scores 1.

    Args:
        scene: the compiled scene.
        poses: where the candidates' objects are placed.
        depths: their pairwise penetration [m].
    """
    v = view(scene.spec)
    first, second = np.triu_indices(len(v.depth), 1)
    both = v.judged[first] & v.judged[second]
    first, second = first[both], second[both]
    if not len(first):
        return jnp.ones(poses.scale.shape[0])
    corners = scene.corners * poses.scale[..., None, None]
    world = jnp.einsum("poij,pocj->poci", rotation(poses.quat), corners) + poses.pos[:, :, None]
    local = (world - v.position) @ v.axes
    away = jnp.maximum(local[..., 2], 1e-3)
    px = local[..., :2] / away[..., None] * v.focal
    low, high = jnp.min(px, axis=2), jnp.max(px, axis=2)
    centre, size = (low + high) / 2, jnp.sqrt(jnp.prod(high - low, axis=-1) + 1e-9)
    depth = jnp.mean(away, axis=2)

    # Depth ordering: the parsed difference of depth must keep its sign, and near ties may be either.
    told = v.depth[first] - v.depth[second]
    seen = depth[:, first] - depth[:, second]
    slack = 0.02 * (v.depth[first] + v.depth[second]) / 2
    order = jnp.clip(0.5 + 0.5 * (np.sign(told) * seen + slack) / slack, 0.0, 1.0)
    order = jnp.where(np.abs(told) < slack, 1.0, order)

    # Relative size: log ratio of projected sizes; where one is partly hidden, of depths and scales.
    full = v.whole[first] & v.whole[second]
    ratio = jnp.log(size[:, first] / size[:, second]) - np.log(v.size[first] / v.size[second])
    grown = jnp.log(poses.scale)
    ratio = jnp.where(full, ratio, grown[:, first] - grown[:, second])
    relative = 1.0 - jnp.abs(ratio) / SIZE_TOLERANCE

    # Relative orientation: direction from one object to the other in the picture. Objects drawn
    # almost concentrically have no direction; their offset is compared with their size instead.
    told_way = v.centre[second] - v.centre[first]
    seen_way = centre[:, second] - centre[:, first]
    reach = np.maximum(
        np.linalg.norm(told_way, axis=-1), 0.5 * np.maximum(v.size[first], v.size[second])
    )
    off = jnp.linalg.norm(seen_way - told_way, axis=-1) / reach
    turn = 1.0 - 2.0 * jnp.arcsin(jnp.minimum(off / 2, 1.0)) / TURN_TOLERANCE

    hidden = jnp.maximum(depths[:, first, second], depths[:, second, first])
    apart = 1.0 - hidden / SEEN_DEPTH

    criteria = [jnp.mean(_discrete(x), axis=1) for x in (order, relative, turn, apart)]
    return jnp.mean(jnp.stack(criteria), axis=0)


def _discrete(x: Float[Array, "pop pair"]) -> Float[Array, "pop pair"]:
    return jnp.round(jnp.clip(x, 0.0, 1.0) * LEVELS) / LEVELS
