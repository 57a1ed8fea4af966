"""Drawings on the page of `neoworld annotate`: photograph, grid, 2D boxes and 3D boxes."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...render.part_meshes import RGB
from ...spec import Box2D, Camera, SceneSpec
from ...spec.pose import from_matrix
from .scene_nodes import NEAR_M

if TYPE_CHECKING:
    from ...annotation.annotation import Annotation

CHOSEN, OTHER, SOLID, GRID = (255, 210, 60), (90, 170, 255), (120, 230, 140), (255, 255, 255)
FAR, FARTHEST_M = 40.0, 800.0
"""Distance of the photograph from the camera, as a multiple of the camera's height, and its upper
limit [m]."""
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1]


def draw_photo(server: Any, camera: Camera, picture: NDArray) -> None:
    """Show the photograph behind the scene, aligned with the view of the photograph's camera.

    Args:
        server: the viser server.
        camera: camera of the photograph.
        picture: the photograph, uint8 [h, w, 3].
    """
    axes, distance = camera.axes(), _distance(camera)
    height = 2 * distance * math.tan(camera.fovy / 2)
    server.scene.add_image(
        "/photo",
        picture,
        height * camera.width / camera.height_px,
        height,
        cast_shadow=False,
        receive_shadow=False,
        wxyz=from_matrix(axes),
        position=camera.position() + distance * axes[:, 2],
    )


def draw_grid(server: Any, camera: Camera, step: float) -> None:
    """Draw a grid on the ground, with lines at distances of `step` [m]."""
    reach = min(40 * step, _distance(camera) / 2)
    ticks = np.arange(-reach, reach + step / 2, step)
    lines = [[[0.0, y, 0.0], [2 * reach, y, 0.0]] for y in ticks]
    lines += [[[x + reach, -reach, 0.0], [x + reach, reach, 0.0]] for x in ticks]
    _add_lines(server, "/grid", np.array(lines), GRID, 1)


def draw_boxes(server: Any, annotation: "Annotation", chosen: str) -> str:
    """Draw the 2D boxes in the picture, and the resulting 3D boxes in the world.

    Args:
        server: the viser server.
        annotation: the annotation.
        chosen: name of the object to highlight.

    Returns:
        The size of the highlighted object as a string; empty if no object is highlighted.

    Raises:
        SpecError: the boxes do not define a valid scene. The 2D boxes are drawn anyway.
    """
    from ...annotation.annotated_tree import annotated_tree

    with server.atomic():
        hide_boxes(server)
        for obj in annotation.objects:
            color = CHOSEN if obj.name == chosen else OTHER
            draw_box(server, annotation.camera, obj.name, obj.box, color)
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
    """Draw lines on the photograph, and crosses at their end points.

    Args:
        server: the viser server.
        camera: camera of the photograph.
        ends: end points of successive lines [px], each of shape [2]. The last line may lack its
            second end point.
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


def pixel_of(view: Any, camera: Camera, position: tuple[float, float]) -> NDArray:
    """Return the pixel [2] of the photograph at a position in a client's window.

    The client must look through the photograph's camera.

    Args:
        view: camera of the client.
        camera: camera of the photograph.
        position: horizontal and vertical position in the window, 0 to 1.
    """
    window = np.array([view.image_width, view.image_height])
    focal = view.image_height / 2 / math.tan(view.fov / 2)
    offset = (np.array(position) - 0.5) * window * camera.focal / focal
    size = np.array([camera.width, camera.height_px])
    return np.clip(size / 2 + offset, 0.0, size)


def draw_box(server: Any, camera: Camera, name: str, box: Box2D, rgb: RGB) -> None:
    """Draw an object's 2D box in front of the photograph's camera."""
    x0, y0, x1, y1 = box.as_tuple()
    rays = camera.rays(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]))
    depth = rays @ camera.axes()[:, 2]
    points = camera.position() + rays * (NEAR_M / depth)[:, None]
    lines = np.stack([points[:-1], points[1:]], axis=1)
    _add_lines(server, f"/boxes/{name}", lines, rgb, 3)


def hide_boxes(server: Any) -> None:
    """Remove all boxes."""
    server.scene.remove_by_name("/boxes")


def _add_lines(server: Any, name: str, lines: NDArray, rgb: Any, thickness: float) -> None:
    server.scene.add_line_segments(name, lines, rgb, thickness=thickness, thickness_units="screen")


def _distance(camera: Camera) -> float:
    return min(FAR * max(camera.height, 0.05), FARTHEST_M)


def draw_photo_box(server: Any, scene: SceneSpec, name: str) -> None:
    """Draw the 2D box of the named object, if it has one, and remove all other boxes."""
    hide_boxes(server)
    for obj in scene.objects:
        if obj.name == name and obj.box2d is not None and scene.camera is not None:
            draw_box(server, scene.camera, obj.name, obj.box2d, CHOSEN)
