"""Pictures of a programmed object for critics, rendered from the photo's direction of view."""

import hashlib
from collections.abc import Callable, Mapping
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..mllm import Picture
from ..render import View, render, render_object, to_png
from ..render.scene_images import visible_vertices
from ..spec import (
    Camera,
    ObjectSpec,
    SceneObject,
    TreeNode,
    single_object_scene,
)
from ..spec.opening import with_prerequisites
from ..spec.pose import from_yaw, quat_mul, rotate
from ..spec.scale import fit_to_box
from .critique import to_camera

WIDTH, HEIGHT = 448, 384
HALF_PX = 640
"""Longer side of each half of the picture "compared" [px]."""
GAP_PX = 8
"""Width of the white gap between the halves [px]."""
AROUND = 128
"""Gray level around a crop that is smaller than its half."""
OPEN_FRACTION = 0.8
"""Position of joints in the picture "opened", as a fraction of the open limit."""
FRAME = (255, 255, 255)
MIN_VISIBLE = 0.1
"""Smallest fraction of the object's 2D box in the crop for a picture beside the crop."""
NEAR_M = 0.02
"""An object that has a vertex closer to the camera than this [m] is rendered alone."""

Window = tuple[float, float, float, float]


class DescribedPicture(Picture):
    """A picture that recorded responses identify by its description instead of its pixels.

    Rounding in ray casting differs between processors. If recorded responses (tapes) were
    identified by pixels, they could not be replayed on another machine. The picture is rendered
    when its data is first accessed.

    Args:
        label: name of the picture in the prompt.
        draw: renders the picture as PNG.
        shows: description of the object, its state and the view.
    """

    def __init__(self, label: str, draw: Callable[[], bytes], shows: str) -> None:
        self.label, self._draw, self.shows = label, draw, shows

    @cached_property
    def data(self) -> bytes:
        """The PNG file, rendered once."""
        return self._draw()

    @cached_property
    def pixels(self) -> str:
        """The sha256 of the description."""
        return hashlib.sha256(self.shows.encode()).hexdigest()


def draw(
    spec: ObjectSpec, node: TreeNode, camera: Camera | None, *, opened: bool = False
) -> DescribedPicture:
    """Return a picture of an object alone, from the direction of the photo's camera.

    Args:
        spec: the object.
        node: the parsed object, which states the pose in the scene.
        camera: the photo's camera; if None, the view shows the front from the right and above.
        opened: if True, open the joints.
    """
    state = open_state(spec) if opened else {}
    return _picture(
        "opened" if opened else "made", spec, state, view_from(spec, state, node, camera)
    )


def draw_exported(
    spec: ObjectSpec, read: ObjectSpec, node: TreeNode, camera: Camera | None
) -> list[Picture]:
    """Return pictures of an object that was read back from URDF.

    The pictures are "exported" and, if the object has joints that move, "opened".

    Args:
        spec: the exported object, by which recorded responses identify the pictures.
        read: the object that was read back.
        node: the parsed object, which states the pose in the scene.
        camera: the photo's camera.
    """
    states = {"exported": {}, "opened": open_state(spec)}
    return [
        _picture(label, spec, state, view_from(spec, state, node, camera), read)
        for label, state in states.items()
        if label == "exported" or state
    ]


def _picture(
    label: str,
    spec: ObjectSpec,
    state: Mapping[str, float],
    view: View,
    exported: ObjectSpec | None = None,
) -> DescribedPicture:
    shows = f"{spec.to_json()}{sorted(state.items())}{_numbers(view)}{WIDTH}x{HEIGHT}"
    shows = shows if exported is None else f"urdf{shows}"

    def render_png() -> bytes:
        return to_png(render_object(exported or spec, state, view, width=WIDTH, height=HEIGHT))

    return DescribedPicture(label, render_png, shows)


def compare(
    crop: Picture, spec: ObjectSpec, node: TreeNode, camera: Camera | None, window: Window | None
) -> list[Picture]:
    """Return the picture "compared": the crop on the left, the built object on the right.

    Both halves have the same camera, frame and size. If the object extends beyond the crop, the
    frame does as well: gray surrounds the crop, and a white frame marks it on the right. Without a
    view of the photo, with less of the object's 2D box than `MIN_VISIBLE` in the crop, or with the
    object too close to the camera (`why_apart`), the result is the crop and the picture of `draw`.

    Args:
        crop: the crop.
        spec: the object, which is scaled to the parsed box.
        node: the parsed object, which states the pose and how far parts are open.
        camera: the photo's camera.
        window: area of the photo that the crop shows (x0, y0, x1, y1) [px].
    """
    if camera is None or window is None or why_apart(spec, node, camera, window):
        return [crop, draw(spec, node, camera)]
    obj, points = _place(spec, node)
    extent, frame = _extent(camera, points), np.array(window)
    x0, y0, x1, y1 = (
        np.concatenate([np.minimum(extent[:2], frame[:2]), np.maximum(extent[2:], frame[2:])])
        .round(1)
        .tolist()
    )
    view = View.through(camera, (x0, y0, x1, y1), HALF_PX)

    def render_png() -> bytes:
        made = np.array(render(single_object_scene(obj), view).color)
        scale = view.width / (x1 - x0)
        marked = ((frame - [x0, y0, x0, y0]) * scale).round().astype(int)
        if (x0, y0, x1, y1) != tuple(frame.round(1).tolist()):
            _outline(made, marked)
        left, top = np.clip(marked[:2], 0, [view.width - 1, view.height - 1]).tolist()
        size = np.minimum(marked[2:], [view.width, view.height]) - [left, top]
        shown = Image.fromarray(crop.rgb).resize(np.maximum(size, 1).tolist())
        half = np.full_like(made, AROUND)
        half[top : top + shown.height, left : left + shown.width] = shown
        gap = np.full((view.height, GAP_PX, 3), 255, np.uint8)
        return to_png(np.concatenate([half, gap, made], axis=1))

    place = np.round([*obj.xy, obj.z, obj.yaw, *obj.base_tilt], 4).tolist()
    # The last digits of a fitted pose differ between processors.
    state = sorted((name, round(value, 4)) for name, value in obj.joint_state.items())
    lens = [round(camera.focal, 2), x0, y0, x1, y1, *np.round(window, 1).tolist()]
    shows = f"{crop.pixels}{spec.to_json()}{state}{place}{_numbers(view)}{lens}"
    return [DescribedPicture("compared", render_png, shows)]


def why_apart(
    spec: ObjectSpec, node: TreeNode, camera: Camera | None, window: Window | None
) -> str:
    """Return why `compare` does not draw the object next to the crop; empty if it does."""
    if camera is None or window is None:
        return "the direction of the photo is unknown"
    _, points = _place(spec, node)
    if camera.project(points)[1].min() < NEAR_M:
        return f"the object reaches closer than {NEAR_M:g} m to the camera"
    extent = _extent(camera, points)
    low, high = np.maximum(extent[:2], window[:2]), np.minimum(extent[2:], window[2:])
    area = max(float(np.prod(extent[2:] - extent[:2])), 1)
    visible = float(np.prod(np.maximum(high - low, 0))) / area
    if visible < MIN_VISIBLE:
        return f"the crop shows {visible:.0%} of the object, the rest is cut off or elsewhere"
    return ""


def _extent(camera: Camera, points: NDArray) -> NDArray:
    """Return the box of projected points (x0, y0, x1, y1) [px]."""
    pixels, _ = camera.project(points)
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])


def _place(spec: ObjectSpec, node: TreeNode) -> tuple[SceneObject, NDArray]:
    """Return an object that is scaled to its parsed box and placed in its parsed pose.

    Returns:
        The object, and its visible vertices in the world frame [m], shape [n, 3].
    """
    fit = fit_to_box(spec, node)
    scaled, state = fit.scaled()
    low, high = fit.low * fit.factor, fit.high * fit.factor
    offset = np.array([-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]])
    vertices = visible_vertices(scaled, state)
    lowest = rotate(node.base_tilt, vertices + offset)[:, 2].min()
    local_offset = rotate(node.base_tilt, offset) - [0, 0, lowest]
    x, y, z = (
        rotate(from_yaw(node.box3d.yaw), local_offset) + np.array(node.box3d.position)
    ).tolist()
    obj = SceneObject(
        name=node.name,
        spec=scaled,
        xy=(x, y),
        z=z,
        yaw=node.box3d.yaw,
        base_tilt=node.base_tilt,
        joint_state=state,
    )
    rotation = quat_mul(from_yaw(node.box3d.yaw), np.array(node.base_tilt))
    return obj, rotate(rotation, vertices) + [x, y, z]


def _outline(canvas: NDArray, box: NDArray) -> None:
    """Draw a frame with a width of one pixel into a picture, clipped to the picture."""
    height, width = canvas.shape[:2]
    x0, y0, x1, y1 = box.tolist()
    columns, rows = np.clip([x0, x1], 0, width), np.clip([y0, y1], 0, height)
    for x in (x0, x1 - 1):
        if 0 <= x < width:
            canvas[rows[0] : rows[1], x] = FRAME
    for y in (y0, y1 - 1):
        if 0 <= y < height:
            canvas[y, columns[0] : columns[1]] = FRAME


def _numbers(view: View) -> list[float]:
    # The last digits of the view differ between processors.
    return np.round(np.concatenate([view.eye, view.axes.ravel()]), 4).tolist()


def view_from(
    spec: ObjectSpec, state: Mapping[str, float], node: TreeNode, camera: Camera | None
) -> View:
    """Return a view of the whole object from the camera's direction, in the object's frame."""
    points = visible_vertices(spec, state)
    if camera is None:
        return View.framing(points, width=WIDTH, height=HEIGHT)
    away = to_camera(node, camera)
    away = away / np.linalg.norm(away)
    return View.framing(
        points,
        width=WIDTH,
        height=HEIGHT,
        azimuth=float(np.arctan2(away[1], away[0])),
        # At a lower elevation the floor would hide the object.
        elevation=float(np.clip(np.arcsin(away[2]), np.radians(5), np.radians(85))),
    )


def open_state(spec: ObjectSpec) -> dict[str, float]:
    """Return open positions [rad or m] of all joints that move and do not follow another joint."""
    state = {}
    for joint in spec.joints:
        if joint.type == "fixed" or joint.mimic is not None:
            continue
        if joint.type == "ball":
            # Tilt the child towards the front.
            state[f"{joint.name}.y"] = OPEN_FRACTION * min(joint.upper or 1.0, 1.0)
            continue
        turns = joint.type == "continuous"
        limit = joint.upper if abs(joint.upper) >= abs(joint.lower) else joint.lower
        state[joint.name] = 0.8 if turns else OPEN_FRACTION * limit
    # Joints that others require to be open are opened fully.
    return with_prerequisites(spec, state, opening=True)
