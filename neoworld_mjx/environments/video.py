"""Video of a policy in a scene."""

import io
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from ..errors import EngineError, SpecError, choices
from ..io.files import write_output
from ..spec import SceneSpec, read_scene
from .arm import scene_state
from .evaluation import episode
from .policy import Policy
from .training import task_scene

FORMATS = {".webp": "WEBP", ".gif": "GIF"}
DISTANCE_M, ELEVATION_DEG = 1.6, -25.0
"""Of the camera, from the point of the task."""


def play(
    policy: Policy,
    run: Path | str | SceneSpec,
    path: Path,
    *,
    size: tuple[int, int] = (480, 640),
    azimuth: float = 140.0,
) -> bool:
    """Write a video of an episode, and return whether the policy succeeds.

    Args:
        policy: the policy.
        run: a run folder, a scene.json or a scene.
        path: file .webp or .gif.
        size: height and width [px].
        azimuth: direction of the camera's view about the vertical [deg].

    Raises:
        SpecError: the policy does not fit the scene, or the format is unknown.
        EngineError: MuJoCo cannot render on this machine.
    """
    if path.suffix not in FORMATS:
        raise SpecError(f"video {path.name}: format: {choices(path.suffix, FORMATS)}")
    scene = run if isinstance(run, SceneSpec) else read_scene(Path(run))
    task = task_scene(scene, policy.about.setting, visual=True)
    model = task.controlled.model
    model.vis.global_.offheight, model.vis.global_.offwidth = size
    states = episode(policy, task)
    camera = mujoco.MjvCamera()
    camera.distance, camera.elevation, camera.azimuth = DISTANCE_M, ELEVATION_DEG, azimuth
    camera.lookat[:] = task.controlled.tool(scene_state(states[0]))[0]
    try:
        renderer = mujoco.Renderer(model, *size)
    except Exception as error:
        raise EngineError(
            f"MuJoCo cannot render here ({error}): set MUJOCO_GL=egl, or osmesa without a GPU"
        ) from None
    frames = []
    with renderer:
        for data in states:
            renderer.update_scene(data, camera)
            frames.append(Image.fromarray(np.asarray(renderer.render())))
    milliseconds = round(1000 * policy.about.setting.control_s)
    buffer = io.BytesIO()
    frames[0].save(
        buffer,
        FORMATS[path.suffix],
        save_all=True,
        append_images=frames[1:],
        duration=milliseconds,
        loop=0,
    )
    write_output(path, buffer.getvalue(), SpecError)
    return bool(task.success(scene_state(states[-1])))
