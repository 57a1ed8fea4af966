"""Host-side descriptions that every room shares: validated, JSON both ways, no JAX."""

from .camera import Camera
from .object import (
    Geom,
    Joint,
    Material,
    Mimic,
    ObjectSpec,
    Part,
    Site,
    bounds,
    inertial,
    link_poses,
    pieces,
    recentred,
)
from .scale import scale
from .scene import SceneObject, SceneSpec, rearranged, support_frame, world_poses
from .shapes import Box, Capsule, Cylinder, Ellipsoid, HollowBox, Lathe, Prism, Shape, Sphere
from .tree import Box2D, Box3D, PartState, SceneTree, TreeNode

__all__ = [
    "Box",
    "Box2D",
    "Box3D",
    "Camera",
    "Capsule",
    "Cylinder",
    "Ellipsoid",
    "Geom",
    "HollowBox",
    "Joint",
    "Lathe",
    "Material",
    "Mimic",
    "ObjectSpec",
    "Part",
    "PartState",
    "Prism",
    "SceneObject",
    "SceneSpec",
    "SceneTree",
    "Shape",
    "Site",
    "Sphere",
    "TreeNode",
    "bounds",
    "inertial",
    "link_poses",
    "pieces",
    "rearranged",
    "recentred",
    "scale",
    "support_frame",
    "world_poses",
]
