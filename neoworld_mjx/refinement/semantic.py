"""S_sem by geometry: agreement of the composed poses with the photograph's relations.

S_sem is the mean of the paper's four criteria (Appendix B), each rounded to steps. They compare the
parsed 2D boxes and depths, seen through the parsed camera, with the projection of a candidate's
surface samples. Relations are scored by pairs of objects; orientation also by how
each object fills its own box, since that is all that a box says about a heading.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..physics.layout import Poses, rotation
from ..physics.model import SceneModel
from ..physics.sampling import surface_samples
from ..spec import Camera, SceneSpec, world_poses

SAMPLES = 256
"""Surface samples that give the 2D box of an object without a parsed one."""
LEVELS = 20
"""Steps of a score: 0, 1/20, ... 1."""
SIZE_TOLERANCE = 0.4
"""Difference of log size ratios at which the relative-size score is zero."""
TURN_TOLERANCE = np.radians(45.0)
"""Difference of direction at which a pair's orientation score is zero."""
BOX_TOLERANCE = 0.25
"""Mean distance of box edges, over the box's size, at which a box's score is zero."""
SEEN_DEPTH = 0.01
"""Penetration [m] at which an intersection is certainly visible."""
BOX_NOISE_PX, BOX_NOISE = 2.0, 0.02
"""Noise of a parsed box edge: pixels, and a share of the box's size."""


class PhotoView(NamedTuple):
    """The photograph's camera, boxes and depths, by object."""

    axes: np.ndarray
    position: np.ndarray
    focal: float
    boxes: np.ndarray
    """2D boxes [object, 4]: left, top, right, bottom from the middle of the picture [px]."""
    depth: np.ndarray
    """Distance along the view [m]."""
    judged: np.ndarray
    """True for objects that count, which are all but environment supports."""
    whole: np.ndarray
    """True for objects whose 2D box shows all of them."""

    @property
    def centre(self) -> np.ndarray:
        """Middles of the boxes [object, 2]."""
        return (self.boxes[:, :2] + self.boxes[:, 2:]) / 2

    @property
    def size(self) -> np.ndarray:
        """Square roots of the boxes' areas [px]."""
        return np.sqrt(np.prod(self.boxes[:, 2:] - self.boxes[:, :2], axis=-1))


def photo_view(spec: SceneSpec) -> PhotoView:
    """Collect the photograph's boxes and depths; the composed scene gives those not parsed."""
    camera = spec.camera or _camera_for(spec)
    middle = np.tile([camera.width / 2, camera.height_px / 2], 2)
    poses = world_poses(spec)
    boxes, depth = [], []
    for item in spec.objects:
        box, distance = item.box2d and item.box2d.as_tuple(), item.depth
        if box is None or distance is None:
            with jax.ensure_compile_time_eval():
                points = np.asarray(surface_samples(item, SAMPLES), float)
            pixels, distances = camera.project(poses[item.name].apply(points))
            box = [*pixels.min(axis=0), *pixels.max(axis=0)] if box is None else box
            distance = distances.mean() if distance is None else distance
        boxes.append(np.array(box) - middle)
        depth.append(distance)
    return PhotoView(
        camera.axes(),
        camera.position(),
        camera.focal,
        np.array(boxes),
        np.array(depth),
        np.array([not item.environment for item in spec.objects]),
        np.array([not item.occluded for item in spec.objects]),
    )


def _camera_for(scene: SceneSpec) -> Camera:
    far = max(float(np.abs(pose.pos).max()) for pose in world_poses(scene).values())
    return Camera(width=600, height_px=400, fovy=0.8, height=1.0 + far, pitch=0.6)


def projected(
    scene: SceneModel, v: PhotoView, poses: Poses
) -> tuple[Float[Array, "pop object 4"], Float[Array, "pop object"]]:
    """Project candidates' surface samples to 2D boxes [px] and depths [m], as in `PhotoView`."""
    # Sums of products, which XLA fuses with the minima; small matrix products are slow on CPUs.
    turn = rotation(poses.quat) * poses.scale[..., None, None]
    gap = poses.pos - v.position
    turn = _dot([axis[:, None] for axis in v.axes], [turn[..., None, i, :] for i in range(3)])
    shift = _dot(v.axes, [gap[..., None, i] for i in range(3)])
    points = [scene.samples[..., j] for j in range(3)]
    x, y, away = (
        _dot([turn[..., None, k, j] for j in range(3)], points) + shift[..., None, k]
        for k in range(3)
    )
    away = jnp.maximum(away, 1e-3)
    x, y = (side / away * v.focal for side in (x, y))
    box = [x.min(axis=2), y.min(axis=2), x.max(axis=2), y.max(axis=2)]
    return jnp.stack(box, axis=-1), away.mean(axis=2)


def _dot(a: Any, b: Any) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


class Semantic(eqx.Module):
    """S_sem of candidates, in [0, 1]."""

    total: Float[Array, " pop"]
    each: Float[Array, "pop object"]
    """Score by the criteria that involve an object; 1 for objects that are not judged."""


def semantic_score(
    scene: SceneModel, poses: Poses, depths: Float[Array, "pop object object"]
) -> Semantic:
    """Score candidates in [0, 1]; a scene in which nothing is judged scores 1.

    Args:
        scene: the compiled scene.
        poses: where the candidates' objects are placed.
        depths: pairwise penetration [m] of the candidates' objects.
    """
    v = photo_view(scene.spec)
    count = len(v.depth)
    boxes, depth = projected(scene, v, poses)
    own = jnp.mean(jnp.abs(boxes - v.boxes), axis=-1) / v.size
    filled = jnp.where(v.whole & v.judged, _steps(1.0 - own / BOX_TOLERANCE), 1.0)
    first, second = np.triu_indices(count, 1)
    both = v.judged[first] & v.judged[second]
    first, second = first[both], second[both]
    judged = max(int(v.judged.sum()), 1)
    fits = jnp.sum(jnp.where(v.judged, filled, 0.0), axis=1) / judged
    if not v.judged.any():
        return Semantic(jnp.ones(depth.shape[0]), jnp.ones_like(depth))
    if not len(first):
        return Semantic(fits, filled)
    centre = (boxes[..., :2] + boxes[..., 2:]) / 2
    size = jnp.sqrt(jnp.prod(boxes[..., 2:] - boxes[..., :2], axis=-1) + 1e-9)

    # Depth ordering: the parsed difference of depth must keep its sign; near ties may be either.
    parsed = v.depth[first] - v.depth[second]
    own = depth[:, first] - depth[:, second]
    slack = 0.02 * (v.depth[first] + v.depth[second]) / 2
    order = 0.5 + 0.5 * (np.sign(parsed) * own + slack) / slack
    order = jnp.where(np.abs(parsed) < slack, 1.0, order)

    # Relative size: log ratio of projected sizes; where one is partly hidden, of depths and scales.
    full = v.whole[first] & v.whole[second]
    ratio = jnp.log(size[:, first] / size[:, second]) - np.log(v.size[first] / v.size[second])
    grown = jnp.log(poses.scale)
    ratio = jnp.where(full, ratio, grown[:, first] - grown[:, second])
    relative = 1.0 - jnp.abs(ratio) / SIZE_TOLERANCE

    # Relative orientation: direction from one object to the other in the picture. Objects drawn
    # almost concentrically have no direction; their offset is compared with their size instead.
    parsed_way = v.centre[second] - v.centre[first]
    own_way = centre[:, second] - centre[:, first]
    reach = np.maximum(
        np.linalg.norm(parsed_way, axis=-1), 0.5 * np.maximum(v.size[first], v.size[second])
    )
    off = jnp.linalg.norm(own_way - parsed_way, axis=-1) / reach
    turn = 1.0 - 2.0 * jnp.arcsin(jnp.minimum(off / 2, 1.0)) / TURN_TOLERANCE

    hidden = jnp.maximum(depths[:, first, second], depths[:, second, first])
    apart = 1.0 - hidden / SEEN_DEPTH

    # Pairs decide half of orientation, boxes the other half.
    pairs = (_steps(order) + _steps(relative) + _steps(turn) / 2 + _steps(apart)) / 4
    member = np.zeros((len(first), count))
    member[np.arange(len(first)), first] = member[np.arange(len(first)), second] = 1.0
    partners = np.maximum(member.sum(axis=0), 1.0)
    each = jnp.where(v.judged, (pairs @ member) / partners + filled / 8, 1.0)
    return Semantic(jnp.mean(pairs, axis=1) + fits / 8, each)


def _steps(x: Float[Array, "pop column"]) -> Float[Array, "pop column"]:
    return jnp.round(jnp.clip(x, 0.0, 1.0) * LEVELS) / LEVELS


def reprojection_error(scene: SceneModel, poses: Poses) -> Float[Array, " pop"]:
    """Return the squared distance of projected boxes from the photograph's, in units of its noise.

    Differentiable; beyond three units it grows linearly (Huber), as a parsed box may be plainly
    wrong. Only objects whose box shows all of them count.
    """
    v = photo_view(scene.spec)
    boxes, _ = projected(scene, v, poses)
    off = (boxes - v.boxes) / (BOX_NOISE_PX + BOX_NOISE * v.size[:, None])
    huber = jnp.where(jnp.abs(off) < 3.0, off**2 / 2, 3.0 * (jnp.abs(off) - 1.5))
    return jnp.sum(jnp.where((v.whole & v.judged)[:, None], huber, 0.0), axis=(1, 2))
