"""Move the objects of a response after a correction of its camera, so that they keep their pixels.

The positions in a response are consistent with the picture only through its camera. If the camera
changes, each object is moved to the position that has the same pixel in the new camera.
"""

import math
from collections.abc import Collection, Sequence

from ..spec import Camera
from .object_schema import ParsedCamera, ParsedObject
from .response_to_tree import camera_of

FARTHEST = 3.0
"""Maximum factor by which the distance of an object from the camera may grow or shrink."""


def moved_with_camera(
    objects: Sequence[ParsedObject],
    before: ParsedCamera,
    after: ParsedCamera,
    size: tuple[int, int],
    *,
    placed: Collection[str] = (),
) -> list[ParsedObject]:
    """Return the objects at positions with the same pixels and heights in the new camera.

    An object keeps its position if the position is outside the picture, or if the distance from the
    camera would change by more than a factor of three.

    Args:
        objects: the objects of the response.
        before: the old camera, for which the positions were given.
        after: the new camera.
        size: width and height of the picture that the model saw [px].
        placed: names of objects whose positions were given for the new camera.

    Raises:
        ValidationError: a camera is invalid.
    """
    old, new = (camera_of(parsed, size) for parsed in (before, after))
    return [obj if obj.name in placed else _moved_object(obj, old, new) for obj in objects]


def _moved_object(obj: ParsedObject, old: Camera, new: Camera) -> ParsedObject:
    at = obj.position
    pixel, depth = old.project([at.x, at.y, at.z])
    inside = (pixel >= 0).all() and (pixel <= [old.width, old.height_px]).all()
    if depth <= 0 or not inside:
        return obj
    ray = new.rays(pixel)
    distance = (at.z - new.height) / ray[2] if ray[2] else math.inf
    before = math.dist((at.x, at.y, at.z), (0.0, 0.0, old.height))
    if not before / FARTHEST < distance < before * FARTHEST:
        return obj
    new_position = {"x": float(distance * ray[0]), "y": float(distance * ray[1])}
    return obj.model_copy(update={"position": at.model_copy(update=new_position)})
