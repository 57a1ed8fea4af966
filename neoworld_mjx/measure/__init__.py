"""Metrics of the paper's tables."""

from .boxes import iou_2d, iou_3d
from .moves import Move, object_moves
from .scene_check import SETTLED_AWAY, SceneCheck, measured, passes, scene_checks, with_displacement
from .stability import SceneMeasure, scene_measure
from .unstable import UnstableObject, unstable_objects
from .visible_boxes import SidesShown, box_iou, shown_sides, visible_box_iou, visible_box_iou_of

__all__ = [
    "SETTLED_AWAY",
    "Move",
    "SceneCheck",
    "SceneMeasure",
    "SidesShown",
    "UnstableObject",
    "box_iou",
    "iou_2d",
    "iou_3d",
    "measured",
    "object_moves",
    "passes",
    "scene_checks",
    "scene_measure",
    "shown_sides",
    "unstable_objects",
    "visible_box_iou",
    "visible_box_iou_of",
    "with_displacement",
]
