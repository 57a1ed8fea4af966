"""Measures that compare scenes, objects and images with ground truth, for the tables."""

from .joint_measure import JointMeasure, JointPair, joint_measure, pooled
from .object_truth import ObjectTruth, TrueJoint, canonical_points, read_truth, truth_of
from .object_truth_mjcf import truth_of_mjcf
from .picture_similarity import PictureMeasure, PictureModels, picture_measure
from .structural_similarity import ssim
from .surface_measure import Closeness, GeometryMeasure, geometry_measure

__all__ = [
    "Closeness",
    "GeometryMeasure",
    "JointMeasure",
    "JointPair",
    "ObjectTruth",
    "PictureMeasure",
    "PictureModels",
    "TrueJoint",
    "canonical_points",
    "geometry_measure",
    "joint_measure",
    "picture_measure",
    "pooled",
    "read_truth",
    "ssim",
    "truth_of",
    "truth_of_mjcf",
]
