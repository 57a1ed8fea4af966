"""What the page of `neoworld annotate` shows: photograph, grid, boxes, and the boxes they give."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...render.part_meshes import RGB
from ...spec import Box2D, Camera
from ...spec.pose import from_matrix
from .scene_nodes import NEAR_M

if TYPE_CHECKING:
    from ...annotation.annotation import Annotation

CHOSEN, OTHER, SOLID, GRID = (255, 210, 60), (90, 170, 255), (120, 230, 140), (255, 255, 255)
FAR, FARTHEST_M = 40.0, 800.0
"""Distance of the photograph behind the scene in heights of the camera, and its bound."""
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1]


def draw_photo(server: Any, camera: Camera, picture: NDArray) -> None:
    """Put the photograph behind all else, as the camera sees it.

    Args:
        server: of viser.
        camera: of the photograph.
        picture: uint8 [h, w, 3].
    """
    axes, far = camera.axes(), _far(camera)
    tall = 2 * far * math.tan(camera.fovy / 2)
    server.scene.add_image(
        "/photo",
        picture,
        tall * camera.width / camera.height_px,
        tall,
        cast_shadow=False,
        receive_shadow=False,
        wxyz=from_matrix(axes),
        position=camera.position() + far * axes[:, 2],
    )


def draw_grid(server: Any, camera: Camera, step: float) -> None:
    """Draw lines on the ground, `step` m apart."""
    reach = min(40 * step, _far(camera) / 2)
    ticks = np.arange(-reach, reach + step / 2, step)
    lines = [[[0.0, y, 0.0], [2 * reach, y, 0.0]] for y in ticks]
    lines += [[[x + reach, -reach, 0.0], [x + reach, reach, 0.0]] for x in ticks]
    _add_lines(server, "/grid", np.array(lines), GRID, 1)


def draw_boxes(server: Any, annotation: "Annotation", chosen: str) -> str:
    """Draw the boxes in the picture, and those that they give in the world.

    Args:
        server: of viser.
        annotation: what to draw.
        chosen: name of the object to stress.

    Returns:
        How large the chosen object is; empty where there is none.

    Raises:
        SpecError: the boxes give no scene; those in the picture are drawn.
    """
    from ...annotation.annotation import annotated_tree

    with server.atomic():
        hide_boxes(server)
        for obj in annotation.objects:
            colour = CHOSEN if obj.name == chosen else OTHER
            draw_box(server, annotation.camera, obj.name, obj.box, colour)
        if not annotation.objects:
            return ""
        tree = annotated_tree(annotation)
        for obj in annotation.objects:
            corners = tree.node(obj.name).box3d.corners()
            lines = np.array([[corners[a], corners[b]] for a, b in _EDGES])
            _add_lines(server, f"/boxes/{obj.name}/solid", lines, SOLID, 2)
    if all(obj.name != chosen for obj in annotation.objects):
        return ""
    size = " x ".join(f"{100 * v:.1f}" for v in tree.node(chosen).box3d.size)
    return f"{chosen}: {size} cm (depth, width, height)"


def draw_marks(server: Any, camera: Camera, ends: Sequence[NDArray]) -> None:
    """Draw crosses at pixels of the photograph, and a line between every two.

    Args:
        server: of viser.
        camera: of the photograph.
        ends: pixels [2], ends of lines in turn.
    """
    cross, lines = camera.height_px / 80, []
    for pixel in ends:
        lines += [
            [pixel - [cross, 0], pixel + [cross, 0]],
            [pixel - [0, cross], pixel + [0, cross]],
        ]
    lines += [[ends[k], ends[k + 1]] for k in range(0, len(ends) - 1, 2)]
    rays = camera.rays(np.array(lines).reshape(-1, 2))
    points = camera.position() + rays * (NEAR_M / (rays @ camera.axes()[:, 2]))[:, None]
    _add_lines(server, "/marks", points.reshape(-1, 2, 3), CHOSEN, 3)


def pixel_of(view: Any, camera: Camera, at: tuple[float, float]) -> NDArray:
    """Return the pixel [2] of the photograph at a place of a window that looks through its camera.

    Args:
        view: camera of the client.
        camera: of the photograph.
        at: across and down the window, 0 to 1.
    """
    window = np.array([view.image_width, view.image_height])
    focal = view.image_height / 2 / math.tan(view.fov / 2)
    offset = (np.array(at) - 0.5) * window * camera.focal / focal
    size = np.array([camera.width, camera.height_px])
    return np.clip(size / 2 + offset, 0.0, size)


def draw_box(server: Any, camera: Camera, name: str, box: Box2D, rgb: RGB) -> None:
    """Draw an object's box in the photograph, just in front of its camera."""
    x0, y0, x1, y1 = box.as_tuple()
    rays = camera.rays(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]))
    depth = rays @ camera.axes()[:, 2]
    points = camera.position() + rays * (NEAR_M / depth)[:, None]
    lines = np.stack([points[:-1], points[1:]], axis=1)
    _add_lines(server, f"/boxes/{name}", lines, rgb, 3)


def hide_boxes(server: Any) -> None:
    """Take all boxes away."""
    server.scene.remove_by_name("/boxes")


def _add_lines(server: Any, name: str, lines: NDArray, rgb: Any, thickness: float) -> None:
    server.scene.add_line_segments(name, lines, rgb, thickness=thickness, thickness_units="screen")


def _far(camera: Camera) -> float:
    return min(FAR * max(camera.height, 0.05), FARTHEST_M)
