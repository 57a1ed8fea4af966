"""An object to be programmed, and phrases for requests about its parts, its view and its tilt."""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..mllm import Picture
from ..spec import Camera, TreeNode
from ..spec.pose import conjugate, from_yaw, quat_mul, rotate

MIN_TILT_DEG = 1.0
LIES_DEG, OVER_DEG = 60.0, 120.0
"""Tilts [deg] above which a request describes an object as lying, and as turned over."""
STEP_DEG = 5
"""Directions are rounded to multiples of this angle [deg]."""
Edge = Annotated[float, Field(gt=0, le=100)]
Edges = Annotated[list[Edge], Field(min_length=3, max_length=3)]
VIEW = (
    "direction of view: the camera stands {azimuth} from the object's front and {elevation} "
    "degrees {above} it{left}\n"
)
OPEN_PARTS = (
    ", with {parts} as in the photo (draw it closed, so that opened like that it fills this box)"
)


class Subject(NamedTuple):
    """An object to be programmed."""

    node: TreeNode
    crop: Picture
    note: str = ""
    """Description of the parts that the crop does not show; empty if it shows the whole object."""
    camera: Camera | None = None
    """The photo's camera; if None, requests do not state the direction of view."""
    window: tuple[float, float, float, float] | None = None
    """Area of the photo that the crop shows (x0, y0, x1, y1) [px]; None if unknown."""


def moving_parts(node: TreeNode) -> str:
    """List the moving parts that the photo shows, with the types of their joints."""
    if not node.articulation:
        return "none noted"
    return ", ".join(f"{state.part} ({state.type})" for state in node.articulation)


def opened_parts(node: TreeNode) -> str:
    """Describe the parts that were open when the box was measured; empty if none was."""
    parts = [f"{part.part} {part.opening:.0%} open" for part in node.articulation if part.opening]
    return OPEN_PARTS.format(parts=", ".join(parts)) if parts else ""


def view_in_words(node: TreeNode, camera: Camera | None) -> str:
    """Describe the photo's direction of view in the object's frame."""
    if camera is None:
        return ""
    azimuth, elevation = seen_from(node, camera)
    azimuth_deg, elevation_deg = (
        STEP_DEG * round(angle / STEP_DEG) for angle in (azimuth, elevation)
    )
    side = "to its own left" if azimuth_deg > 0 else "to its own right"
    left = ""
    if not _tilt_deg(node):
        # Beyond 45 degrees to a side the picture's left is another axis of the object.
        names = {0: "-y, its own right", 1: "+x, its front", 2: "+y, its own left"}
        left = (
            f"; the picture's left is its {names.get(round(azimuth_deg / 90) % 4, '-x, its back')}"
        )
    around = "0 degrees" if azimuth_deg == 0 else f"{abs(azimuth_deg)} degrees {side}"
    above = "below" if elevation_deg < 0 else "above"
    return VIEW.format(azimuth=around, elevation=abs(elevation_deg), above=above, left=left)


def seen_from(node: TreeNode, camera: Camera) -> tuple[float, float]:
    """Return the direction from an object to the camera, in the object's frame.

    Returns:
        The azimuth about the object's z axis [deg], which is 0 at the object's front and 90 at the
        object's left, and the elevation [deg].
    """
    x, y, z = to_camera(node, camera).tolist()
    return math.degrees(math.atan2(y, x)), math.degrees(math.atan2(z, math.hypot(x, y)))


def to_camera(node: TreeNode, camera: Camera) -> NDArray:
    """Return the vector from an object's center to the camera, in the object's frame [m]."""
    rotation = conjugate(quat_mul(from_yaw(node.box3d.yaw), np.array(node.base_tilt)))
    center = np.array(node.box3d.position) + [0, 0, node.box3d.size[2] / 2]
    return rotate(rotation, camera.position() - center)


def _tilt_deg(node: TreeNode) -> float:
    """Return an object's tilt [deg]; a tilt below MIN_TILT_DEG is returned as 0."""
    z = float(rotate(node.base_tilt, (0.0, 0.0, 1.0))[2])
    degrees = math.degrees(math.acos(max(-1.0, min(1.0, z))))
    return 0.0 if degrees < MIN_TILT_DEG else degrees


def tilt_in_words(node: TreeNode, template: str) -> str:
    """Describe how an object leans, lies or is turned over; empty if it is upright."""
    degrees = _tilt_deg(node)
    if not degrees:
        return ""
    if degrees > 180 - MIN_TILT_DEG:
        return template.format(way="it stands upside down")
    x, y, _ = rotate(node.base_tilt, (0.0, 0.0, 1.0)).tolist()
    side = ("front" if x > 0 else "back") if abs(x) >= abs(y) else ("left" if y > 0 else "right")
    posture = "it leans" if degrees < LIES_DEG else "it lies"
    posture = "it is turned over" if degrees > OVER_DEG else posture
    return template.format(
        way=f"{posture}, tilted by {degrees:.0f} degrees, its top towards its own {side}"
    )
