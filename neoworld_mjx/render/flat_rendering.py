"""Render with flat colours, one light and outlines, in a fraction of the time: no shadows or grain.

For many candidates, where the places of objects matter and not their looks.
"""

import numpy as np
from jaxtyping import UInt8
from numpy.typing import NDArray

from ..spec import Camera, SceneSpec
from .appearance import display, linear
from .lighting import FLOOR_COLOUR, HORIZON
from .ray_caster import RayCaster
from .rendering import compile_posed
from .view import View

_AMBIENT, _SKY, _KEY = 0.25, 0.3, 0.55
_OUTLINE = 0.45
"""How bright a pixel remains on the border of an object."""


def render_plain(
    scene: SceneSpec, camera: Camera | View, *, width: int | None = None
) -> UInt8[np.ndarray, "height width 3"]:
    """Render with flat colours.

    Args:
        scene: the scene, in its own poses and joint states.
        camera: from where.
        width: in pixels; None takes the camera's own.

    Returns:
        Display colour (sRGB), the same bytes for the same scene.
    """
    if isinstance(camera, Camera):
        view = View.of(camera, width)
    else:
        tall = round((width or camera.width) * camera.height / camera.width)
        view = camera._replace(width=width or camera.width, height=max(1, tall))
    model, data = compile_posed(scene)
    rows, columns = np.mgrid[: view.height, : view.width]
    pixels = np.stack([columns + 0.5, rows + 0.5], axis=-1).reshape(-1, 2)
    rays = view.rays(pixels)
    hits = RayCaster(model, data).hits(view.eye, rays, smooth=False)

    rgba = model.geom_rgba.copy()
    with_material = model.geom_matid >= 0
    rgba[with_material] = model.mat_rgba[model.geom_matid[with_material]]
    body = np.flatnonzero(hits.geom >= 0)
    normal = hits.normal[body]
    # From over the left shoulder, so that the three sides of a box differ.
    towards = view.axes @ np.array([-0.5, -0.7, -0.5])
    facing = np.maximum(normal @ (towards / np.linalg.norm(towards)), 0.0)
    light = _AMBIENT + _SKY * (0.5 + 0.5 * normal[:, 2]) + _KEY * facing
    picture = np.where(rays[:, 2:] < 0.0, FLOOR_COLOUR, HORIZON)
    picture[body] = linear(rgba[:, :3])[hits.geom[body]] * light[:, None]

    owner = np.append(model.body_rootid[model.geom_bodyid], -1)[hits.geom]
    border = _borders(owner.reshape(view.height, view.width)).ravel()
    picture[border] *= _OUTLINE
    return display(picture).reshape(view.height, view.width, 3)


def _borders(owner: NDArray) -> NDArray:
    """Return the pixels [h, w] whose right or lower neighbour belongs to another object."""
    border = np.zeros(owner.shape, bool)
    border[:, :-1] |= owner[:, :-1] != owner[:, 1:]
    border[:-1] |= owner[:-1] != owner[1:]
    return border


__all__ = ["render_plain"]
