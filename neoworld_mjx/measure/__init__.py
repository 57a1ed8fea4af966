"""The metrics of the paper's tables; each says over how many things it was taken."""

from .boxes import iou_2d, iou_3d
from .geometry import Closeness, GeometryMeasure, geometry_measure
from .joints import JointMeasure, JointPair, joint_measure, pooled
from .parsing import ParseMeasure, parse_measure
from .stability import SceneMeasure, scene_measure
from .truth import ObjectTruth, TrueJoint, canonical_points, read_truth, truth_of
from .truth_mjcf import truth_of_mjcf

__all__ = [
    "Closeness",
    "GeometryMeasure",
    "JointMeasure",
    "JointPair",
    "ObjectTruth",
    "ParseMeasure",
    "SceneMeasure",
    "TrueJoint",
    "canonical_points",
    "geometry_measure",
    "iou_2d",
    "iou_3d",
    "joint_measure",
    "parse_measure",
    "pooled",
    "read_truth",
    "scene_measure",
    "truth_of",
    "truth_of_mjcf",
]
