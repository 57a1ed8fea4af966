"""Metrics of the paper's tables."""

from .boxes import (
    Move,
    box_iou,
    iou_2d,
    object_moves,
    visible_box_iou,
)
from .scene_check import (
    HELD,
    SETTLED_AWAY,
    SceneCheck,
    SceneMeasure,
    measured,
    passes,
    rest_and_measure,
    resting,
    scene_checks,
    with_displacement,
)

__all__ = [
    "HELD",
    "SETTLED_AWAY",
    "Move",
    "SceneCheck",
    "SceneMeasure",
    "box_iou",
    "iou_2d",
    "measured",
    "object_moves",
    "passes",
    "rest_and_measure",
    "resting",
    "scene_checks",
    "visible_box_iou",
    "with_displacement",
]
