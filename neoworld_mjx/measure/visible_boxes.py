"""Overlap of what a scene shows of its objects with what the parse saw in the photograph."""

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

    own: Bool[np.ndarray, "4"]
    """Whether the object itself ends there: in the picture, and nothing is before it."""
    inside: Bool[np.ndarray, "4"]
    """Whether the extreme point of the whole object lies in the picture."""


def shown_sides(scene: SceneSpec) -> dict[str, SidesShown]:
    """Return which sides of its visible box each object's own outline makes, as the camera sees it.

    Environment supports are left out, and so is everything if the scene has no camera.
    """
    if scene.camera is None:
        return {}
    from ..physics.layout import Layout
    from ..physics.model import compile_scene
    from ..physics.placed import placed_in_chunks
    from ..physics.scene_arrays import pad_scene

    padded = pad_scene(compile_scene(scene))
    visible = placed_in_chunks(padded, Layout.zero(1, padded.count)).visible
    own, whole = np.asarray(visible.own_sides)[0], np.asarray(visible.outlines.boxes)[0]
    half = np.tile(np.asarray(padded.photo.half_size), 2)
    return {
        item.name: SidesShown(own[k], np.abs(whole[k]) <= half)
        for k, item in enumerate(scene.objects)
        if not item.environment
    }


def visible_box_iou(scene: SceneSpec) -> dict[str, float]:
    """Return the intersection over union of each object's visible box with its parsed one.

    Both are of what the photograph's camera sees: hidden parts and what lies beyond the picture's
    border are left out. An object that cannot be seen has 0. Environment supports and objects
    without a parsed box are left out, and so is everything if the scene has no camera.
    """
    if scene.camera is None:
        return {}
    from ..physics.layout import Layout
    from ..physics.model import compile_scene
    from ..physics.placed import placed_in_chunks
    from ..physics.scene_arrays import pad_scene

    padded = pad_scene(compile_scene(scene))
    seen = placed_in_chunks(padded, Layout.zero(1, padded.count)).visible
    return seen_box_iou(scene, padded, seen)


def seen_box_iou(scene: SceneSpec, padded: "SceneArrays", seen: "Visible") -> dict[str, float]:
    """Return `visible_box_iou` of a compiled scene of which it is known what the camera sees.

    Args:
        scene: the description that was compiled.
        padded: its arrays, padded to their bucket.
        seen: of a single candidate.
    """
    if scene.camera is None:
        return {}
    boxes, parsed = np.asarray(seen.boxes)[0], np.asarray(padded.photo.boxes)
    return {
        item.name: iou_2d(boxes[k], parsed[k])
        for k, item in enumerate(scene.objects)
        if item.box2d is not None and not item.environment
    }


def parsed_box_iou(tree: SceneTree) -> dict[str, float]:
    """Return the same of the parse's 3D boxes, cut at the picture's border.

    They hide nothing from one another, since boxes of open things would hide what is in them.
    """
    size = np.array([tree.camera.width, tree.camera.height_px])
    ious = {}
    for node in tree.nodes:
        if not node.environment:
            pixels, _ = tree.camera.project(node.box3d.corners(node.base_tilt))
            ends = np.clip([pixels.min(axis=0), pixels.max(axis=0)], 0, size)
            ious[node.name] = iou_2d(ends.ravel(), node.box2d)
    return ious


def box_iou(tree: SceneTree, composed: SceneSpec, refined: SceneSpec) -> dict[str, Any]:
    """Compare the boxes of a run's parse, composed scene and refined scene with the parsed boxes.

    Returns:
        "parsed", "composed", "refined": means over the objects, None where there are none; "worst":
        name and value of the refined scene's worst; "objects": by name the values of all three.
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
