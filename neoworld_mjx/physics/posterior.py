"""Draws from what a photograph leaves open: poses, sizes, the camera, and physics.

The alignment estimates poses and sizes with their standard deviations (`SceneObject.uncertainty`)
and correlations (`SceneSpec.correlation`). Quantities that no picture shows have a prior.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..spec import SceneSpec, joint_value
from ..spec.correlation import EACH, PoseCorrelation
from .layout import Layout, Variation
from .model import CompiledScene
from .photo_view import photo_deviations

RANK = 1e-3
"""Singular value below which values determine nothing of the normal numbers; correlations are
stored with four decimals."""


FREEDOM, SPREAD, WIDEST = 3.0, 0.70, 3.0
"""Degrees of freedom and scale of Student's t distribution of the draws, and greatest factor of
their deviations. Errors of the estimate have heavy tails by scene: most scenes are better than
their deviations say, and some are far worse. The scale keeps the 90 % intervals."""


class PhysicalPrior(NamedTuple):
    """Standard deviations of quantities that no picture shows, or that are not estimated.

    The center of each prior is the value in the scene. Deviations are of logarithms, except that of
    openings. All are assumed, not measured:

    - density: walls, fillings and kinds of wood are not seen;
    - friction of contacts: the material is that of the program;
    - dry friction and damping of joints: within a factor of 2, because they are derived from the
      weight of the part (`program/assemble.py`);
    - opening of a joint that is neither closed nor fully open, as a fraction of its range, within
      which it stays. Joints that others follow, or on whose parts objects stand, keep theirs.
    """

    density: float = 0.30
    friction: float = 0.25
    joint_friction: float = 0.70
    joint_damping: float = 0.70
    opening: float = 0.06


class Draws(NamedTuple):
    """Draws about a scene."""

    layouts: Layout
    variation: Variation
    camera: Float[np.ndarray, "pop 4"]
    """Changes of the camera's pitch and roll [rad], and of the logarithms of its focal length and
    height."""
    normals: Float[np.ndarray, "pop normal"]
    """Normal numbers of deviation `spread`, from which `pose_factor` makes layouts and camera."""
    spread: Float[np.ndarray, " pop"]
    """Factor of all deviations of each draw."""

    @classmethod
    def of(
        cls,
        normals: Float[np.ndarray, "pop normal"],
        spread: Float[np.ndarray, " pop"],
        factor: Float[np.ndarray, "value normal"],
        variation: Variation,
    ) -> "Draws":
        """Return draws, given normal numbers and the matrix of `pose_factor`."""
        values = normals @ factor.T
        each = values[:, EACH:].reshape(len(values), -1, EACH)
        layouts = Layout(each[..., :2], each[..., 2], each[..., 3])
        return cls(layouts, variation, values[:, :EACH], normals, spread)


def pose_factor(scene: SceneSpec) -> Float[np.ndarray, "value normal"]:
    """Return a matrix F, such that F z has the covariance of the estimate if z is standard normal.

    The values are four of the camera, as in `Draws.camera`, and then four of each object: x and y
    [m] in the frame of its support, yaw [rad] and log size. An object or camera that was not
    aligned does not vary. Without stored correlations, all deviations are independent.
    """
    axes, others = photo_deviations(scene)
    names = [item.name for item in scene.objects]
    known = scene.correlation or PoseCorrelation()
    count = 4 * (1 + len(names))
    correlation = np.eye(count)
    rows = [0, *(1 + names.index(name) for name in known.objects if name in names)]
    kept = [0, *(1 + k for k, name in enumerate(known.objects) if name in names)]
    block = lambda objects: (4 * np.array(objects)[:, None] + np.arange(4)).ravel()
    if known.objects:
        correlation[np.ix_(block(rows), block(rows))] = known.matrix()[
            np.ix_(block(kept), block(kept))
        ]
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    scale = np.zeros((count, count))
    scale[:EACH, :EACH] = np.diag(known.camera)
    for k in range(len(names)):
        first = EACH * (1 + k)
        scale[first : first + 2, first : first + 2] = axes[k]
        scale[first + 2, first + 2], scale[first + 3, first + 3] = others[k]
    return scale @ root


def draw(
    scene: CompiledScene,
    rng: np.random.Generator,
    n: int,
    prior: PhysicalPrior | None = None,
    *,
    spread: Float[np.ndarray, " n"] | None = None,
) -> Draws:
    """Draw from the estimate of a scene, and from the priors.

    Args:
        scene: the scene.
        rng: random numbers.
        n: number of draws.
        prior: priors of what no picture shows.
        spread: factor of the deviations of poses, sizes and camera of each draw; if None, draws
            have Student's t distribution.
    """
    spec, static, p = scene.spec, scene.static, prior or PhysicalPrior()
    count, joints = len(static.names), len(static.joints)
    if spread is None:
        spread = np.minimum(SPREAD * np.sqrt(FREEDOM / rng.chisquare(FREEDOM, n)), WIDEST)
    normals = spread[:, None] * rng.standard_normal((n, EACH * (1 + count)))
    factors = lambda deviation, size: np.exp(deviation * rng.standard_normal((n, size)))
    variation = Variation(
        factors(p.density, count),
        factors(p.friction, count),
        factors(p.joint_friction, joints),
        factors(p.joint_damping, joints),
        _openings(scene, p.opening * rng.standard_normal((n, joints))),
    )
    return Draws.of(normals, spread, pose_factor(spec), variation)


def _openings(
    scene: CompiledScene, fractions: Float[np.ndarray, "pop joint"]
) -> Float[np.ndarray, "pop joint"]:
    """Return changes of openings within the ranges of the joints, given fractions of the ranges."""
    static, spec = scene.static, scene.spec
    changes = np.zeros_like(fractions)
    for k, name in enumerate(static.joint_names):
        item = spec.objects[static.joint_object[k]]
        joint = item.spec.joint(name.split("-", 1)[1])
        followed = {other.mimic.joint for other in item.spec.joints if other.mimic is not None}
        carries = any(other.parent == item.name and other.parent_link for other in spec.objects)
        value = joint_value(item.spec, joint, item.joint_state)
        shown = joint.type in ("revolute", "prismatic") and joint.lower < value < joint.upper
        if shown and value and not (carries or joint.mimic or joint.name in followed):
            opened = value + fractions[:, k] * (joint.upper - joint.lower)
            changes[:, k] = np.clip(opened, joint.lower, joint.upper) - value
    return changes


def draw_again(
    scene: CompiledScene,
    draws: Draws,
    objects: Bool[np.ndarray, "pop object"],
    rng: np.random.Generator,
    prior: PhysicalPrior | None = None,
) -> Draws:
    """Draw some objects of each draw again, given its camera and its other objects.

    Args:
        scene: the compiled scene.
        draws: the draws, from `draw`.
        objects: mask of the objects that are drawn again.
        rng: random numbers.
        prior: as for `draw`.
    """
    fresh = draw(scene, rng, len(objects), prior, spread=draws.spread)
    factor = pose_factor(scene.spec)
    normals = fresh.normals
    length = np.linalg.norm(factor, axis=1, keepdims=True)
    unit = factor / np.where(length > 0, length, 1.0)
    for k, chosen in enumerate(objects):
        given = unit[np.repeat(np.append(True, ~chosen), EACH)]
        _, size, axes = np.linalg.svd(given, full_matrices=False)
        axes = axes[size > RANK]  # all combinations of normals that the given values depend on
        normals[k] += axes.T @ (axes @ (draws.normals[k] - normals[k]))
    old, new = draws.variation, fresh.variation
    joints = objects[:, np.asarray(scene.static.joint_object, int)]
    variation = Variation(
        np.where(objects, new.mass, old.mass),
        np.where(objects, new.friction, old.friction),
        np.where(joints, new.joint_friction, old.joint_friction),
        np.where(joints, new.joint_damping, old.joint_damping),
        np.where(joints, new.opening, old.opening),
    )
    return Draws.of(normals, draws.spread, factor, variation)
