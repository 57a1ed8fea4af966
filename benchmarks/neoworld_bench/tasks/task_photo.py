"""A task's scene before a camera, where a photograph of it would be taken, and back again.

Tasks are declared about the middle of a table; cameras stand above the world's origin and look
along +x. So the scene is turned and moved, and what was reconstructed from there is moved back.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neoworld_mjx.physics.support import posed_shapes
from neoworld_mjx.spec import Camera, SceneSpec, world_poses
from neoworld_mjx.spec.pose import Pose, from_yaw, pose
from neoworld_mjx.spec.scene import transformed_scene

from ..fidelity.rendered_scenes import see, visible_shares

PITCH, FOVY = math.radians(28.0), math.radians(34.0)
"""View down, and vertical field of view, as most scenes of the benchmark have them [rad]."""
MARGIN = 1.1
"""Room about the sphere that holds all objects, which fills the picture's height otherwise."""
BESIDE_DEG = (0.0, 30.0, -30.0, 60.0, -60.0)
"""Views, counted from the front of objects, which is +x in a task's scene."""
LEAST_SHOWN = 0.5
"""Share of every object that a view should show: the first that does is taken."""
VIEW = (PITCH, FOVY, MARGIN, *BESIDE_DEG, LEAST_SHOWN)
"""The rule's numbers."""


class TaskPhoto(NamedTuple):
    """A task's scene as it was photographed."""

    scene: SceneSpec
    """With its camera, visible boxes, depths and hidden flags."""
    scene_transform: Pose
    """Motion of the task's scene to its place before the camera."""

    def back(self, reconstructed: SceneSpec) -> SceneSpec:
        """Move a scene that was reconstructed from the photograph to where the task's scene is."""
        return transformed_scene(reconstructed, self.scene_transform.inverse())


def photographed_task(scene: SceneSpec) -> TaskPhoto:
    """Photograph a task's scene from the first of BESIDE_DEG that shows LEAST_SHOWN of everything.

    If none does, the view is taken in which the most hidden object shows most.

    Args:
        scene: of a task; objects without a parent stand upright.
    """
    best: tuple[float, SceneSpec, Pose] | None = None
    for beside in BESIDE_DEG:
        transform, camera = _view(scene, math.pi + math.radians(beside))
        moved_scene = transformed_scene(scene, transform).model_copy(update={"camera": camera})
        least_visible = min(
            share
            for name, share in visible_shares(moved_scene).items()
            if not moved_scene.object(name).environment
        )
        if best is None or least_visible > best[0]:
            best = least_visible, moved_scene, transform
        if least_visible >= LEAST_SHOWN:
            break
    assert best is not None
    return TaskPhoto(see(best[1], finer=2), best[2])


def _view(scene: SceneSpec, turn: float) -> tuple[Pose, Camera]:
    """Return what moves a scene before a camera after a turn [rad], and the camera."""
    points = _points(scene)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    radius = float(np.linalg.norm(points - middle, axis=1).max())
    distance = MARGIN * radius / math.sin(FOVY / 2)
    ahead = np.array([distance * math.cos(PITCH), 0.0, 0.0])
    rotation = pose((0.0, 0.0, 0.0), from_yaw(turn))
    transform = pose(ahead - rotation.apply(middle * [1.0, 1.0, 0.0]), rotation.quat)
    camera = Camera(
        width=640,
        height_px=480,
        fovy=FOVY,
        height=float(middle[2]) + distance * math.sin(PITCH),
        pitch=PITCH,
    )
    return transform, camera


def _points(scene: SceneSpec) -> Float[np.ndarray, "n 3"]:
    """Return points of the surfaces of everything but the environment, in the world [m]."""
    poses = world_poses(scene)
    return np.vstack(
        [
            poses[item.name].apply(at.apply(shape.surface()[0]))
            for item in scene.objects
            if not item.environment
            for shape, at in posed_shapes(item)
        ]
    )
