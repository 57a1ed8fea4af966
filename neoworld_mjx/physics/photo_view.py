"""Data of the photograph for scoring: the camera, and 2D boxes and depths of all objects."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..spec import Camera, ObjectSpec, SceneSpec, world_poses
from .array_types import AnyArray
from .sampling import surface_samples

BOX_SAMPLES = 256
"""Number of surface samples that determine the 2D box of an object without a parsed box."""

BORDER_PX = 2.0
"""Distance from the image border within which a box counts as cut by the border."""


class PhotoView(NamedTuple):
    """The photograph's camera, and the boxes and depths of all objects."""

    axes: Float[AnyArray, "3 3"]
    """Columns are the camera's right, down and forward axes in the world."""
    position: Float[AnyArray, " 3"]
    """[m]"""
    focal: Float[AnyArray, ""]
    """[px]"""
    half_size: Float[AnyArray, " 2"]
    """Half the image's width and height [px]."""
    boxes: Float[AnyArray, "object 4"]
    """2D boxes: left, top, right, bottom relative to the image center [px]."""
    parsed: Bool[AnyArray, " object"]
    """True for parsed boxes, which bound the visible part. Other boxes bound the whole object."""
    depth: Float[AnyArray, " object"]
    """Depth along the viewing direction [m]."""
    scored: Bool[AnyArray, " object"]
    """True for scored objects: all but environment supports."""
    fully_visible: Bool[AnyArray, " object"]
    """True for objects that are entirely visible."""
    occludes: Bool[AnyArray, " object"]
    """True for objects that occlude other objects. Transparent objects do not."""
    evidence: Float[AnyArray, "object cell cell"]
    """Evidence that the object is visible in each cell of its window [1/px^2], by row and column;
    see `align.photo_evidence`. There are no cells if the pixels of the photograph are not given."""
    window: Float[AnyArray, "object 4"]
    """Window of the evidence: left, top, right, bottom relative to the image center [px]."""


def photo_view(spec: SceneSpec) -> PhotoView:
    """Collect the photograph's boxes and depths; compute missing ones from the composed scene."""
    camera = spec.camera or _default_camera(spec)
    center = np.tile([camera.width / 2, camera.height_px / 2], 2)
    poses = world_poses(spec)
    boxes, depth, parsed = [], [], []
    for item in spec.objects:
        box, distance = item.box2d and item.box2d.as_tuple(), item.depth
        if box is None or distance is None:
            points = np.asarray(surface_samples(item, BOX_SAMPLES), float)
            pixels, distances = camera.project(poses[item.name].apply(points))
            box = [*pixels.min(axis=0), *pixels.max(axis=0)] if box is None else box
            distance = distances.mean() if distance is None else distance
        boxes.append(np.array(box) - center)
        depth.append(distance)
        parsed.append(item.box2d is not None)
    boxes, depth = np.array(boxes), np.array(depth, float)
    scored = np.array([not item.environment for item in spec.objects])
    occluded = np.array([item.occluded for item in spec.objects])
    inside_image = np.abs(boxes) < center - BORDER_PX
    fully_visible = ~occluded & (inside_image.all(axis=1) | ~np.array(parsed))
    occludes = np.array([not see_through(item.spec) for item in spec.objects])
    return PhotoView(
        axes=camera.axes(),
        position=camera.position(),
        focal=np.array(camera.focal),
        half_size=center[:2],
        boxes=boxes,
        parsed=np.array(parsed),
        depth=depth,
        scored=scored,
        fully_visible=fully_visible,
        occludes=occludes,
        evidence=np.zeros((len(boxes), 0, 0)),
        window=np.tile([0.0, 0.0, 1.0, 1.0], (len(boxes), 1)),
    )


def see_through(spec: ObjectSpec) -> bool:
    """Return whether all visible geoms of an object are see-through."""
    visible_geoms = [geom for part in spec.parts for geom in part.geoms if geom.role != "collision"]
    return bool(visible_geoms) and all(
        spec.material(geom.material).see_through for geom in visible_geoms
    )


def _default_camera(scene: SceneSpec) -> Camera:
    far = max(float(np.abs(pose.pos).max()) for pose in world_poses(scene).values())
    return Camera(width=600, height_px=400, fovy=0.8, height=1.0 + far, pitch=0.6)
