"""The metrics of the paper's tables; each says over how many things it was taken."""

from .boxes import iou_2d, iou_3d
from .parsing import ParseMeasure, parse_measure
from .scene import SceneMeasure, scene_measure

__all__ = ["ParseMeasure", "SceneMeasure", "iou_2d", "iou_3d", "parse_measure", "scene_measure"]
