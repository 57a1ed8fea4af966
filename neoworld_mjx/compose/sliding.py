"""Horizontal displacement of objects in a compiled scene, without compiling it again."""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from ..errors import SpecError
from ..physics.exact import object_of_geom, start_state
from ..spec import SceneSpec, support_frame, world_poses
from ..spec.pose import conjugate, rotate


class SceneColliders(NamedTuple):
    """A compiled scene in its initial state."""

    model: mujoco.MjModel
    data: mujoco.MjData
    owner: NDArray
    """Index of each geom's object; -1 for geoms that do not collide."""


def compile_colliders(scene: SceneSpec) -> SceneColliders:
    """Compile a scene in its initial state.

    Raises:
        SpecError: MuJoCo cannot compile the scene.
    """
    try:
        model, data = start_state(scene)
    except ValueError as error:
        raise SpecError(f"{scene.name}: {error}") from None
    owner = object_of_geom(scene, model)
    owner[(model.geom_contype == 0) & (model.geom_conaffinity == 0)] = -1
    return SceneColliders(model, data, owner)


def supported_geoms(scene: SceneSpec, owner: NDArray, name: str) -> NDArray:
    """Return a mask of the geoms of an object and of all objects that it supports."""
    names = {name}
    for item in scene.objects:
        names |= {item.name} if item.parent in names else set()
    return np.isin(owner, [scene.index(other) for other in names])


def shift_object(scene: SceneSpec, name: str, shift: Float[np.ndarray, " 2"]) -> SceneSpec:
    """Return a scene with an object moved by a horizontal shift [m] in the world frame."""
    obj = scene.object(name)
    local = np.array([*shift, 0.0])
    if obj.parent is not None:
        parent_pose = world_poses(scene)[obj.parent]
        frame = support_frame(scene.object(obj.parent), parent_pose, obj.parent_link)
        local = rotate(conjugate(frame.quat), local)
    xy = tuple((np.array(obj.xy) + local[:2]).tolist())
    items = [o.model_copy(update={"xy": xy}) if o is obj else o for o in scene.objects]
    return scene.model_copy(update={"objects": tuple(items)})
