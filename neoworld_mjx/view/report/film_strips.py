"""Film strips of the composed and the refined scene in free fall, at several times."""

from pathlib import Path

import mujoco
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ...checks.simulation import without_warnings
from ...render import View, render
from ...render.rendering import compile_posed
from ...spec import SceneSpec, read_scene
from .page import elements
from .pictures import embed_pixels

TITLE = "Free fall"
SCENES = (
    ("compose/scene.json", "composed, before the search"),
    ("scene.json", "refined"),
)
TIME_FRACTIONS = (0.0, 0.1, 0.3, 1.0)
"""Times of the frames, as fractions of the duration."""
WIDTH, TIMESTEP_S = 200, 0.004


def film_strips(folder: Path, duration: float) -> Markup:
    """Return the section that shows the free fall of a run's scenes as strips of frames.

    Args:
        folder: the run folder.
        duration: duration of the fall [s].

    Raises:
        NeoWorldError: a scene cannot be read.
    """
    rows = []
    for name, caption in SCENES:
        if (folder / name).is_file():
            frames = fall_frames(read_scene(folder / name), duration)
            strip = np.concatenate([frame for _, frame in frames], axis=1)
            times = ", ".join(f"{seconds:.2g}" for seconds, _ in frames)
            end = "" if len(frames) == len(TIME_FRACTIONS) else "; then the simulation diverges"
            rows.append(embed_pixels(strip, f"{caption}: at {times} s{end}"))
    return elements.section(TITLE, *(rows or [elements.missing("No scene yet.")]))


def fall_frames(scene: SceneSpec, duration: float) -> list[tuple[float, NDArray]]:
    """Simulate a scene in C MuJoCo, and return times [s] and frames, each uint8 [h, w, 3].

    If the simulation diverges, return the frames before that.
    """
    model, data = compile_posed(scene)
    model.opt.timestep = TIMESTEP_S
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    view = _view(scene, model, data)
    mujoco.mj_forward(model, data)
    frames: list[tuple[float, NDArray]] = []
    for fraction in TIME_FRACTIONS:
        while data.time < fraction * duration - TIMESTEP_S / 2:
            with without_warnings():
                mujoco.mj_step(model, data)
            if not np.isfinite(data.qpos).all():
                return frames
        frames.append((fraction * duration, render((model, data), view, supersample=1).color))
    return frames


def _view(scene: SceneSpec, model: mujoco.MjModel, data: mujoco.MjData) -> View:
    """Return the view of the scene's camera or, without a camera, a view of the whole scene."""
    if scene.camera is not None:
        return View.of(scene.camera, WIDTH)
    low = (data.geom_xpos - model.geom_rbound[:, None]).min(axis=0)
    high = (data.geom_xpos + model.geom_rbound[:, None]).max(axis=0)
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    return View.framing(corners, width=WIDTH, height=WIDTH * 2 // 3, azimuth=np.radians(215))
