"""Overlap of the visible boxes of a scene's objects with the parsed boxes of the photograph."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool

from ..spec import SceneSpec, SceneTree
from .boxes import iou_2d

if TYPE_CHECKING:
    from ..physics.scene_arrays import SceneArrays
    from ..physics.visibility import Visible


class SidesShown(NamedTuple):
    """Sides of an object's visible box in a scene: left, top, right, bottom."""

    object_ends: Bool[np.ndarray, "4"]
    """True for each side where the object itself ends, not at an occluder or the image border."""
    inside: Bool[np.ndarray, "4"]
    """True for each side at which the extreme point of the whole object is within the image."""


def _visible(scene: SceneSpec) -> "tuple[SceneArrays, Visible]":
    """Return a scene's padded arrays, and the visible parts of its objects."""
    from ..physics.layout import Layout
    from ..physics.model import compile_scene
    from ..physics.placed import measure_in_chunks, place_in_chunks
    from ..physics.scene_arrays import pad_scene

    padded = pad_scene(compile_scene(scene))
    poses = place_in_chunks(padded, Layout.zero(1, padded.count))
    return padded, measure_in_chunks(padded, poses, poses).visible


def shown_sides(scene: SceneSpec) -> dict[str, SidesShown]:
    """Return, for each object, the sides of its visible box that are ends of the object itself.

    Other sides are edges of an occluder or of the image.

    Environment supports are omitted. The result is empty if the scene has no camera.
    """
    if scene.camera is None:
        return {}
    padded, visible = _visible(scene)
    object_ends, full_boxes = (
        np.asarray(visible.unoccluded_sides)[0],
        np.asarray(visible.outlines.boxes)[0],
    )
    half = np.tile(np.asarray(padded.photo.half_size), 2)
    return {
        item.name: SidesShown(object_ends[k], np.abs(full_boxes[k]) <= half)
        for k, item in enumerate(scene.objects)
        if not item.environment
    }


def visible_box_iou(scene: SceneSpec) -> dict[str, float]:
    """Return the intersection over union of each object's visible box and its parsed box.

    Both boxes bound the part of the object that the photograph's camera sees, which excludes
    occluded parts and parts beyond the image border. The value of an invisible object is 0.
    Environment supports and objects without a parsed box are omitted. The result is empty if the
    scene has no camera.
    """
    return {} if scene.camera is None else visible_box_iou_of(scene, *_visible(scene))


def visible_box_iou_of(
    scene: SceneSpec, padded: "SceneArrays", visible: "Visible"
) -> dict[str, float]:
    """Compute `visible_box_iou` from the visible parts of a compiled scene's objects."""
    if scene.camera is None:
        return {}
    boxes, parsed = np.asarray(visible.boxes)[0], np.asarray(padded.photo.boxes)
    return {
        item.name: iou_2d(boxes[k], parsed[k])
        for k, item in enumerate(scene.objects)
        if item.box2d is not None and not item.environment
    }


def parsed_box_iou(tree: SceneTree) -> dict[str, float]:
    """Return the intersection over union of each parsed 2D box and the projected parsed 3D box.

    The projections are clipped at the image border. Occlusion is ignored, since the 3D box of a
    container would occlude the container's contents.
    """
    size = np.array([tree.camera.width, tree.camera.height_px])
    ious = {}
    for node in tree.nodes:
        if not node.environment:
            pixels, _ = tree.camera.project(node.box3d.corners(node.base_tilt))
            clipped = np.clip([pixels.min(axis=0), pixels.max(axis=0)], 0, size)
            ious[node.name] = iou_2d(clipped.ravel(), node.box2d)
    return ious


def box_iou(tree: SceneTree, composed: SceneSpec, refined: SceneSpec) -> dict[str, Any]:
    """Compare the boxes of a run with the parsed 2D boxes, by intersection over union.

    The boxes of three steps are compared: the 3D boxes of the parse, and the visible boxes in the
    composed scene and in the refined scene.

    Returns:
        "parsed", "composed" and "refined" are the means over all objects, or None if there are no
        objects. "worst" is the name and value of the worst object of the refined scene. "objects"
        contains the three values of each object, by name.
    """
    steps = {
        "parsed": parsed_box_iou(tree),
        "composed": visible_box_iou(composed),
        "refined": visible_box_iou(refined),
    }
    means = {step: float(np.mean([*v.values()])) if v else None for step, v in steps.items()}
    last = steps["refined"]
    worst = min(last, key=lambda name: last[name], default=None)
    return {
        **means,
        "worst": None if worst is None else {"name": worst, "value": last[worst]},
        "objects": {
            name: {step: values.get(name) for step, values in steps.items()} for name in last
        },
    }
