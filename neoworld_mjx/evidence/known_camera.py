"""Known parameters of a photograph's camera, and their effect on a scene tree."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..spec import Camera, SceneTree, TreeNode
from ..spec.pose import Pose, from_yaw, pose

CameraUnknown = str
"""Name of an unknown of the camera: pitch, roll, focal or height."""
EXACT_FOCAL, EXACT_ANGLE, EXACT_HEIGHT = 1e-4, math.radians(0.02), 1e-4
"""Standard deviations of calibrated values: of the logarithms of focal length and height, and of
angles [rad]."""
FARTHEST = 3.0
"""Largest factor by which the distance of an object from the camera changes."""


@dataclass(frozen=True)
class KnownCamera:
    """Known parameters of a photograph's camera; unknown ones are None.

    Lengths in pixels refer to an image of `size`, which shows the same view as the photograph.
    """

    size: tuple[int, int]
    """Width and height of the image [px]."""
    focal: float | None = None
    """Focal length [px]."""
    focal_sd: float = EXACT_FOCAL
    """Standard deviation of the logarithm of the focal length."""
    principal: tuple[float, float] = (0.0, 0.0)
    """Principal point relative to the middle of the image, to the right and down [px]."""
    pitch: float | None = None
    """Downward angle of the view from the horizontal [rad]."""
    roll: float | None = None
    """Clockwise rotation about the view, seen from behind [rad]."""
    angle_sd: float = EXACT_ANGLE
    """Standard deviation of pitch and roll [rad]."""
    height: float | None = None
    """Height above the plane z = 0 of the scene [m]."""
    height_sd: float = EXACT_HEIGHT
    """Standard deviation of the logarithm of the height."""
    base: tuple[float, float, float] | None = None
    """Position of the camera in the base frame of a robot [m]; None without such a frame."""
    heading: float = 0.0
    """Direction of the view about +z in the base frame [rad]."""
    source: str = ""
    """Source of the values, such as a file's name; for messages."""
    focal_source: str = ""
    """Source of the focal length, if it is not `source`."""

    def source_of(self, name: CameraUnknown) -> str:
        """Return where a known parameter comes from; "given" if it is not stated."""
        return (self.focal_source if name == "focal" else "") or self.source or "given"

    def deviations(self) -> dict[CameraUnknown, float]:
        """Return the standard deviation of each known parameter, as in the alignment.

        Angles are in rad; those of focal length and height are of their logarithms.
        """
        known = {
            "pitch": (self.pitch, self.angle_sd),
            "roll": (self.roll, self.angle_sd),
            "focal": (self.focal, self.focal_sd),
            "height": (self.height, self.height_sd),
        }
        return {name: sd for name, (value, sd) in known.items() if value is not None}

    def camera(self, guess: Camera) -> Camera:
        """Return a camera with the known values, and those of `guess` for unknown ones."""
        scale = guess.height_px / self.size[1]
        update: dict[str, object] = {
            "principal": (self.principal[0] * scale, self.principal[1] * scale)
        }
        if self.focal is not None:
            update["fovy"] = 2 * math.atan(self.size[1] / 2 / self.focal)
        for name in ("pitch", "roll", "height"):
            if getattr(self, name) is not None:
                update[name] = getattr(self, name)
        return Camera.model_validate(dict(guess) | update)

    def base_frame(self, camera: Camera) -> Pose | None:
        """Return the pose of the world frame in the base frame, or None without a base frame.

        Args:
            camera: the estimated camera, above the origin of the world frame.
        """
        if self.base is None:
            return None
        x, y, z = self.base
        return pose((x, y, z - camera.height), from_yaw(self.heading))


def with_known_camera(tree: SceneTree, known: KnownCamera) -> SceneTree:
    """Return a tree with the known camera, in which every object keeps its pixels.

    The distance of the objects' middle is kept if the height of the camera is unknown, but changes
    in proportion to the focal length. Every object moves along its line of sight to its height, and
    its size changes with its distance as far as the focal length does not explain the change. The
    environment moves with the objects.

    Args:
        tree: a tree whose camera a model estimated.
        known: the known parameters.
    """
    before, after = tree.camera, known.camera(tree.camera)
    if after == before:
        return tree
    nodes = [node for node in tree.nodes if not node.environment] or list(tree.nodes)
    zoom = after.focal / before.focal
    places = np.array([node.box3d.position for node in nodes])
    middle = np.median(places, axis=0)
    if known.height is None:
        distance = zoom * float(np.linalg.norm(middle - before.position()))
        ray = after.rays(_seen(before, middle))
        height = float(middle[2] - distance * ray[2])
        after = after.model_copy(update={"height": max(height, 0.01)})
    moved = {node.name: _moved(node, before, after, zoom) for node in nodes}
    shifts = [
        np.subtract(moved[node.name].box3d.position, node.box3d.position)[:2] for node in nodes
    ]
    shift = np.median(shifts, axis=0)
    rest = {n.name: _shifted(n, shift) for n in tree.nodes if n.name not in moved}
    all_nodes = tuple((moved | rest)[node.name] for node in tree.nodes)
    return tree.model_copy(update={"camera": after, "nodes": all_nodes})


def _seen(camera: Camera, point: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 2"]:
    """Return the pixel of a point; a point behind the camera is at the principal point."""
    pixel, depth = camera.project(point)
    return pixel if depth > 0 else camera.center


def _moved(node: TreeNode, before: Camera, after: Camera, zoom: float) -> TreeNode:
    place = np.array(node.box3d.position)
    pixel, depth = before.project(place)
    ray = after.rays(pixel)
    distance = (place[2] - after.height) / ray[2] if ray[2] else math.inf
    old = float(np.linalg.norm(place - before.position()))
    if depth <= 0 or not old / FARTHEST < distance < old * FARTHEST:
        return node
    size = distance / old / zoom
    x, y = (after.position() + distance * ray)[:2].tolist()
    box = node.box3d.model_copy(
        update={
            "position": (x, y, node.box3d.position[2]),
            "size": tuple(size * edge for edge in node.box3d.size),
        }
    )
    return node.model_copy(update={"box3d": box})


def _shifted(node: TreeNode, shift: Float[np.ndarray, " 2"]) -> TreeNode:
    x, y, z = node.box3d.position
    position = (x + float(shift[0]), y + float(shift[1]), z)
    box = node.box3d.model_copy(update={"position": position})
    return node.model_copy(update={"box3d": box})
