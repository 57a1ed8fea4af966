"""The metrics of the paper's tables; each says over how many things it was taken."""

from .boxes import iou_2d, iou_3d
from .geometry import Closeness, GeometryMeasure, geometry_measure
from .joints import JointMeasure, JointPair, joint_measure, pooled
from .moves import Move, object_moves
from .parsing import ParseMeasure, parse_measure
from .picture_similarity import PictureMeasure, PictureModels, picture_measure
from .scene_check import SceneCheck, measured, passes, scene_checks
from .stability import SceneMeasure, scene_measure
from .structural_similarity import ssim
from .truth import ObjectTruth, TrueJoint, canonical_points, read_truth, truth_of
from .truth_mjcf import truth_of_mjcf
from .unstable import UnstableObject, unstable_objects
from .visible_boxes import SidesShown, box_iou, seen_box_iou, shown_sides, visible_box_iou

__all__ = [
    "Closeness",
    "GeometryMeasure",
    "JointMeasure",
    "JointPair",
    "Move",
    "ObjectTruth",
    "ParseMeasure",
    "PictureMeasure",
    "PictureModels",
    "SceneCheck",
    "SceneMeasure",
    "SidesShown",
    "TrueJoint",
    "UnstableObject",
    "box_iou",
    "canonical_points",
    "geometry_measure",
    "iou_2d",
    "iou_3d",
    "joint_measure",
    "measured",
    "object_moves",
    "parse_measure",
    "passes",
    "picture_measure",
    "pooled",
    "read_truth",
    "scene_checks",
    "scene_measure",
    "seen_box_iou",
    "shown_sides",
    "ssim",
    "truth_of",
    "truth_of_mjcf",
    "unstable_objects",
    "visible_box_iou",
]
