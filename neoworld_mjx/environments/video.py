"""Video of a policy in a scene, drawn by the project's ray caster, so without OpenGL."""

import io
import math
from pathlib import Path

import jax
import mujoco
import numpy as np
from jaxtyping import Array
from PIL import Image

from ..errors import SpecError, choices
from ..io.files import write_output
from ..render.view import View
from ..spec import SceneSpec, read_scene
from .arm import scene_state
from .cameras import picture
from .policy import Policy
from .task import SceneTask, StateView
from .training import task_scene
from .trials import episodes

FORMATS = {".webp": "WEBP", ".gif": "GIF"}
EVERY = 3
"""Actions between two pictures, each of which takes about a second."""
ASIDE, ELEVATION = math.radians(65.0), math.radians(25.0)
"""Direction of the camera, from that of the robot as seen from the point of the task [rad]."""


def play(
    policy: Policy,
    run: Path | str | SceneSpec,
    path: Path,
    *,
    size: tuple[int, int] = (360, 480),
    azimuth: float | None = None,
) -> bool:
    """Write a video of an episode, and return whether the policy succeeds.

    Args:
        policy: the policy.
        run: a run folder, a scene.json or a scene.
        path: file .webp or .gif.
        size: height and width [px].
        azimuth: direction from the scene to the camera about +z [rad]; if None, beside the robot.

    Raises:
        SpecError: the policy does not fit the scene, or the format is unknown.
    """
    if path.suffix not in FORMATS:
        raise SpecError(f"video {path.name}: format: {choices(path.suffix, FORMATS)}")
    scene = run if isinstance(run, SceneSpec) else read_scene(Path(run))
    setting = policy.about.setting
    # A flying gripper has no geoms but those that collide.
    task = task_scene(scene, setting, visual=setting.robot is not None)
    states = [jax.tree.map(lambda leaf: leaf[0], s) for s in episodes(task, setting, None)(policy)]
    shown = [_posed(task.controlled.model, s.data.qpos) for s in states[::EVERY]]
    view = _view(task, shown, size, azimuth)
    draw = lambda data: picture(
        task.controlled, data, view, width=size[1], height=size[0], shadows=False
    )
    frames = [Image.fromarray(np.asarray(draw(data).color)) for data in shown]
    buffer = io.BytesIO()
    frames[0].save(
        buffer,
        FORMATS[path.suffix],
        save_all=True,
        append_images=frames[1:],
        duration=round(1000 * EVERY * setting.control_s),
        loop=0,
    )
    write_output(path, buffer.getvalue(), SpecError)
    return bool(states[-1].metrics["success"])


def _posed(model: mujoco.MjModel, qpos: Array) -> mujoco.MjData:
    """Return data with the poses of bodies at joint positions [nq]."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return data


def _view(
    task: SceneTask, states: list[mujoco.MjData], size: tuple[int, int], azimuth: float | None
) -> View:
    """Return a view from the side that shows the tool, the point of the task, and the base."""
    controlled = task.controlled
    tools = [controlled.tool(scene_state(data))[0] for data in states]
    worked = [StateView(controlled, scene_state(data)).point(task.task.point) for data in states]
    base = tools[0] if controlled.arm is None else states[0].xpos[controlled.arm.base]
    x, y = (base - worked[0])[:2]
    points = np.array([*tools, *worked, base, worked[0] + (0.0, 0.0, 0.35)])
    side = math.atan2(y, x) + ASIDE if azimuth is None else azimuth
    return View.framing(
        points, width=size[1], height=size[0], azimuth=side, elevation=ELEVATION, margin=1.3
    )
