"""Film strip of a plan."""

import copy

import mujoco
import numpy as np
from PIL import Image

from neoworld_mjx.render import render
from neoworld_mjx.render.view import View

from .execution import execute
from .task import ManipulationTask
from .world import World


def picture_strip(
    task: ManipulationTask,
    times: tuple[float, ...],
    *,
    width: int = 320,
    azimuth_deg: float = 215.0,
    shown_m: float = 0.2,
) -> Image.Image:
    """Render moments of a task's reference plan from one view.

    Args:
        task: the task.
        times: moments [s], in order.
        width: of each picture, of 4 : 3 [pixel].
        azimuth_deg: direction of the camera about +z.
        shown_m: how much of the scene above the table is inside the picture [m].
    """
    moments: list[tuple[mujoco.MjModel, mujoco.MjData]] = []

    def watch(world: World, time: float) -> None:
        if len(moments) < len(times) and time >= times[len(moments)]:
            moments.append((world.model, copy.copy(world.data)))

    execute(task.scene, task.plan, task.predicate, watch=watch, visual=True)
    height = width * 3 // 4
    model, first = moments[0]
    places = np.array(
        [first.body(item.name).xpos for item in task.scene.objects if not item.environment]
    )
    low, high = places.min(axis=0) - 0.05, places.max(axis=0) + 0.05
    corners = [
        [x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (0.0, shown_m)
    ]
    view = View.framing(
        np.array(corners),
        width=width,
        height=height,
        azimuth=np.radians(azimuth_deg),
        margin=1.0,
    )
    strip = Image.new("RGB", (width * len(moments), height))
    for k, (_, data) in enumerate(moments):
        image = render((model, data), view, width=width, height=height)
        strip.paste(Image.fromarray(image.color), (k * width, 0))
    return strip
