"""Objects of a response whose camera is corrected: they keep their pixels.

A response locates objects by pixels through its camera, so another camera moves them.
"""

import math
from collections.abc import Collection, Sequence

from ..spec import Camera
from .object_schema import ParsedCamera, ParsedObject
from .response_to_tree import camera_of

FARTHEST = 3.0
"""Maximum ratio, in both directions, of the distances from the camera after and before."""


def moved_with_camera(
    objects: Sequence[ParsedObject],
    before: ParsedCamera,
    after: ParsedCamera,
    size: tuple[int, int],
    *,
    placed: Collection[str] = (),
) -> list[ParsedObject]:
    """Return objects with the pixels and heights of their footprints that the old camera gave.

    An object keeps its position if that is outside the picture, or if the new position would be
    more than three times as far away or as near.

    Args:
        objects: the objects of the response.
        before: the camera by which they were placed.
        after: the new camera.
        size: width and height of the picture that the model saw [px].
        placed: names of objects whose positions are for the new camera already.

    Raises:
        ValidationError: a camera is invalid.
    """
    old, new = (camera_of(parsed, size) for parsed in (before, after))
    return [obj if obj.name in placed else _moved(obj, old, new) for obj in objects]


def _moved(obj: ParsedObject, old: Camera, new: Camera) -> ParsedObject:
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
    there = {"x": float(distance * ray[0]), "y": float(distance * ray[1])}
    return obj.model_copy(update={"position": at.model_copy(update=there)})
