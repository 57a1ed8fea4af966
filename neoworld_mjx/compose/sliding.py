"""Slide objects level among the colliders of a composed scene, without compiling it again."""

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
    """A scene compiled as it starts."""

    model: mujoco.MjModel
    data: mujoco.MjData
    owner: NDArray
    """Index of each geom's object; -1 of what collides with nothing."""


def colliders(scene: SceneSpec) -> SceneColliders:
    """Compile a scene as it starts.

    Raises:
        SpecError: MuJoCo cannot compile it.
    """
    try:
        model, data = start_state(scene)
    except ValueError as error:
        raise SpecError(f"{scene.name}: {error}") from None
    owner = object_of_geom(scene, model)
    owner[(model.geom_contype == 0) & (model.geom_conaffinity == 0)] = -1
    return SceneColliders(model, data, owner)


def riding(scene: SceneSpec, owner: NDArray, name: str) -> NDArray:
    """Tell which geoms are an object's, or of what stands in or on it."""
    with_it = {name}
    for item in scene.objects:
        with_it |= {item.name} if item.parent in with_it else set()
    return np.isin(owner, [scene.index(other) for other in with_it])


def shifted(scene: SceneSpec, name: str, shift: Float[np.ndarray, " 2"]) -> SceneSpec:
    """Return a scene with an object moved by a level shift [m] in the world."""
    obj = scene.object(name)
    local = np.array([*shift, 0.0])
    if obj.parent is not None:
        at = world_poses(scene)[obj.parent]
        frame = support_frame(scene.object(obj.parent), at, obj.parent_link)
        local = rotate(conjugate(frame.quat), local)
    place = tuple((np.array(obj.xy) + local[:2]).tolist())
    items = [o.model_copy(update={"xy": place}) if o is obj else o for o in scene.objects]
    return scene.model_copy(update={"objects": tuple(items)})
