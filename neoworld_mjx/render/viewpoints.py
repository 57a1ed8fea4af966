"""Views from around the objects of a scene, and turntables."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError, choices
from ..spec import SceneSpec, world_poses
from .rendering import compile_posed, render
from .scene_images import visible_vertices
from .view import FOVY, View


def subject_points(scene: SceneSpec, names: Sequence[str] = ()) -> NDArray:
    """Return the visible vertices of objects in the world frame [m], shape [n, 3].

    Args:
        scene: the scene.
        names: names of the objects. If empty, use all objects except the environment or, if the
            scene has no other objects, the environment.

    Raises:
        SpecError: the scene has no object with one of the names.
    """
    known = [obj.name for obj in scene.objects]
    for name in names:
        if name not in known:
            raise SpecError(f"object {name}: {choices(name, known)}")
    chosen = [obj for obj in scene.objects if obj.name in names]
    chosen = chosen or [obj for obj in scene.objects if not obj.environment] or list(scene.objects)
    poses = world_poses(scene)
    return np.vstack(
        [poses[obj.name].apply(visible_vertices(obj.spec, obj.joint_state)) for obj in chosen]
    )


def around(
    points: NDArray,
    azimuths: NDArray,
    elevation: float,
    *,
    width: int,
    height: int,
    fovy: float = FOVY,
) -> list[View]:
    """Return views from several azimuths, all at the same distance from the center of the points.

    The distance is the largest of those that `View.framing` chooses for the azimuths.

    Args:
        points: points in the world frame [m], shape [n, 3].
        azimuths: azimuths of the cameras about +z [rad]; 0 looks at the front (+x).
        elevation: elevation above the horizontal [rad].
        width: width [px].
        height: height [px].
        fovy: vertical field of view [rad].
    """
    views = [
        View.framing(
            points, width=width, height=height, azimuth=float(a), elevation=elevation, fovy=fovy
        )
        for a in azimuths
    ]
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    distance = max(float(np.linalg.norm(view.eye - centre)) for view in views)
    return [view._replace(eye=centre - distance * view.axes[:, 2]) for view in views]


def turntable(scene: SceneSpec, views: list[View], *, supersample: int = 2) -> Iterator[NDArray]:
    """Render a scene from several views, and yield the images, each uint8 [h, w, 3].

    The scene is compiled only once.
    """
    posed = compile_posed(scene)
    for view in views:
        yield render(posed, view, supersample=supersample).color


def with_open_joints(scene: SceneSpec, share: float) -> SceneSpec:
    """Return the scene with each limited joint at a fraction of its range, from 0 to the far limit.

    The far limit is the limit with the larger absolute value. Mimic joints follow their leaders.
    """
    objects = []
    for obj in scene.objects:
        state = dict(obj.joint_state)
        for joint in obj.spec.joints:
            if joint.type in ("revolute", "prismatic") and joint.mimic is None:
                far_limit = max(joint.lower, joint.upper, key=abs)
                state[joint.name] = share * far_limit
        objects.append(obj.model_copy(update={"joint_state": state}))
    return scene.model_copy(update={"objects": tuple(objects)})
