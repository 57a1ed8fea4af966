"""Video of a policy in a scene."""

import io
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import UInt8
from PIL import Image

from ..errors import SpecError, choices
from ..io.files import write_output
from ..spec import SceneSpec, read_scene
from .arm import scene_state
from .cameras import picture
from .controlled_scene import ControlledScene
from .evaluation import episode
from .policy import Policy
from .training import task_scene

FORMATS = {".webp": "WEBP", ".gif": "GIF"}
DISTANCE_M, ELEVATION_DEG = 1.6, -25.0
"""Of the camera, from the tool at the start."""
EVERY = 5
"""Steps between two pictures of the ray caster, which takes a second or more for each."""


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
        azimuth: direction of the camera's view about the vertical [deg], drawn by MuJoCo with
            OpenGL. If None, the camera is that of the photograph, and the project's ray caster
            draws every fifth state.

    Raises:
        SpecError: the policy does not fit the scene, the format is unknown, or the scene has no
            camera and no azimuth is given.
    """
    if path.suffix not in FORMATS:
        raise SpecError(f"video {path.name}: format: {choices(path.suffix, FORMATS)}")
    scene = run if isinstance(run, SceneSpec) else read_scene(Path(run))
    if azimuth is None and scene.camera is None:
        raise SpecError(f"scene {scene.name} has no camera of a photograph: give an azimuth")
    setting = policy.about.setting
    task = task_scene(scene, setting, visual=True)
    states = episode(policy, task)
    if azimuth is None:
        every, (height, width) = EVERY, size
        shown = [
            picture(task.controlled, data, width=width, height=height, shadows=False).color
            for data in states[::every]
        ]
    else:
        every, shown = 1, _with_opengl(task.controlled, states, size, azimuth)
    frames = [Image.fromarray(np.asarray(frame)) for frame in shown]
    buffer = io.BytesIO()
    frames[0].save(
        buffer,
        FORMATS[path.suffix],
        save_all=True,
        append_images=frames[1:],
        duration=round(1000 * every * setting.control_s),
        loop=0,
    )
    write_output(path, buffer.getvalue(), SpecError)
    return bool(task.success(scene_state(states[-1])))


def _with_opengl(
    controlled: ControlledScene,
    states: list[mujoco.MjData],
    size: tuple[int, int],
    azimuth: float,
) -> list[UInt8[np.ndarray, "height width 3"]]:
    """Return a picture of each state by MuJoCo's renderer.

    Raises:
        SpecError: this machine has no OpenGL.
    """
    camera = mujoco.MjvCamera()
    camera.distance, camera.elevation, camera.azimuth = DISTANCE_M, ELEVATION_DEG, azimuth
    camera.lookat[:] = controlled.tool(scene_state(states[0]))[0]
    try:
        renderer = mujoco.Renderer(controlled.model, *size)
    except Exception as error:
        raise SpecError(
            f"MuJoCo cannot draw here ({error}): set MUJOCO_GL=egl or osmesa, or give no azimuth"
        ) from None
    shown = []
    with renderer:
        for data in states:
            renderer.update_scene(data, camera)
            shown.append(renderer.render())
    return shown
