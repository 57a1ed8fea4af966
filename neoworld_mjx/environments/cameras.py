"""Cameras of a controlled scene: that of the photograph, and one at the robot's wrist.

Pictures come from the project's ray caster, so they need no OpenGL: color, depth and segmentation.
"""

import math
from typing import Literal

import mujoco
import numpy as np

from ..errors import SpecError
from ..render.rendering import RenderedImage, render
from ..render.view import View
from ..spec.pose import matrix, pose
from .arm import scene_state
from .controlled_scene import ControlledScene

CameraName = Literal["photo", "wrist"]
WRIST_M = (-0.07, 0.0, -0.12)
"""Position of the wrist's camera in the frame of the tool, along whose z axis it looks [m]."""
WRIST_FOVY = math.radians(70.0)


def camera_view(
    controlled: ControlledScene,
    data: mujoco.MjData,
    camera: CameraName = "photo",
    *,
    width: int = 320,
    height: int = 240,
) -> View:
    """Return the view of a camera.

    Args:
        controlled: the scene.
        data: its state, after `mj_kinematics`.
        camera: photo, of the photograph; or wrist, which moves with the tool.
        width: width of its images [px].
        height: height of its images [px].

    Raises:
        SpecError: the scene has no such camera.
    """
    if camera == "photo":
        if controlled.scene.spec.camera is None:
            raise SpecError(f"scene {controlled.scene.spec.name} has no camera of a photograph")
        return View.of(controlled.scene.spec.camera, width, height)
    tool = pose(*controlled.tool(scene_state(data)))
    x, y, z = matrix(tool.quat).T
    return View(tool.apply(WRIST_M), np.column_stack([y, -x, z]), WRIST_FOVY, width, height)


def picture(
    controlled: ControlledScene,
    data: mujoco.MjData,
    camera: CameraName | View = "photo",
    *,
    width: int = 320,
    height: int = 240,
    shadows: bool = True,
) -> RenderedImage:
    """Render a state with the robot: `color`, `depth` [m] and `segmentation` by root body.

    Args:
        controlled: the scene; compiled with `visual=True`, it shows smooth surfaces.
        data: its state, after `mj_kinematics`.
        camera: a camera of `camera_view`, or any view.
        width: width [px].
        height: height [px].
        shadows: if False, omit shadows, which halves the time.

    Raises:
        SpecError: the scene has no such camera.
    """
    if isinstance(camera, View):
        view = camera.resized(width, height)
    else:
        view = camera_view(controlled, data, camera, width=width, height=height)
    spec = controlled.scene.spec
    return render((controlled.model, data), view, spec=spec, shadows=shadows)
