"""Measures that compare scenes, objects and images with ground truth, for the tables."""

from .joint_measure import (
    JointMeasure,
    JointPair,
    ObjectTruth,
    TrueJoint,
    canonical_points,
    joint_measure,
    truth_of,
)
from .picture_similarity import PictureModels, ssim
from .surface_measure import Closeness, GeometryMeasure, geometry_measure

__all__ = [
    "Closeness",
    "GeometryMeasure",
    "JointMeasure",
    "JointPair",
    "ObjectTruth",
    "PictureModels",
    "TrueJoint",
    "canonical_points",
    "geometry_measure",
    "joint_measure",
    "ssim",
    "truth_of",
]
