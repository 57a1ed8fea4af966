"""Measures that compare scenes and objects with ground truth, for the tables."""

from .joint_measure import (
    JointMeasure,
    JointPair,
    ObjectTruth,
    TrueJoint,
    canonical_points,
    joint_measure,
    truth_of,
)
from .surface_measure import Closeness, GeometryMeasure, geometry_measure

__all__ = [
    "Closeness",
    "GeometryMeasure",
    "JointMeasure",
    "JointPair",
    "ObjectTruth",
    "TrueJoint",
    "canonical_points",
    "geometry_measure",
    "joint_measure",
    "truth_of",
]
