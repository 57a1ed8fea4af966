"""Film strips of free fall: the composed and the refined scene at a few times."""

from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...checks.simulation import without_warnings
from ...render import View, render
from ...render.rendering import compile_posed
from ...spec import SceneSpec, read_scene
from .page import Html, embedded, missing, section

TITLE = "Free fall"
SCENES = (
    ("compose/scene.json", "composed, before the search"),
    ("scene.json", "refined"),
)
SHARES = (0.0, 0.1, 0.3, 1.0)
"""Times of the frames, as shares of the duration."""
WIDTH, TIMESTEP_S = 200, 0.004


def film_strips(folder: Path, duration: float) -> Html:
    """Show the free fall of a run's scenes as strips of frames.

    Args:
        folder: the run folder.
        duration: of the fall [s].

    Raises:
        NeoWorldError: a scene cannot be read.
    """
    rows = []
    for place, said in SCENES:
        if (folder / place).is_file():
            frames = fall(read_scene(folder / place), duration)
            strip = np.concatenate([frame for _, frame in frames], axis=1)
            times = ", ".join(f"{seconds:.2g}" for seconds, _ in frames)
            ended = "" if len(frames) == len(SHARES) else "; then the simulation diverges"
            rows.append(embedded(strip, f"{said}: at {times} s{ended}"))
    note = missing("No scene yet.") if not rows else ""
    return section(TITLE, note, *rows)


def fall(scene: SceneSpec, duration: float) -> list[tuple[float, NDArray]]:
    """Let a scene fall in C MuJoCo; return frames uint8 [h, w, 3] with their times [s].

    A simulation that diverges ends with the last frame before.
    """
    model, data = compile_posed(scene)
    model.opt.timestep = TIMESTEP_S
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    view = _view(scene, model, data)
    mujoco.mj_forward(model, data)
    frames: list[tuple[float, NDArray]] = []
    for share in SHARES:
        while data.time < share * duration - TIMESTEP_S / 2:
            with without_warnings():
                mujoco.mj_step(model, data)
            if not np.isfinite(data.qpos).all():
                return frames
        frames.append((share * duration, render((model, data), view, supersample=1).color))
    return frames


def _view(scene: SceneSpec, model: mujoco.MjModel, data: mujoco.MjData) -> View:
    """Return the photograph's view, or without one a view of all."""
    if scene.camera is not None:
        return View.of(scene.camera, WIDTH)
    low = (data.geom_xpos - model.geom_rbound[:, None]).min(axis=0)
    high = (data.geom_xpos + model.geom_rbound[:, None]).max(axis=0)
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    return View.framing(corners, width=WIDTH, height=WIDTH * 2 // 3, azimuth=np.radians(215))
