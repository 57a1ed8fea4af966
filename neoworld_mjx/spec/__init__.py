"""Descriptions of objects and scenes that all packages share.

Descriptions are validated, convert to and from JSON, and do not use JAX.
"""

from .base import JointKey, Name, Number, Quat, Spec, Vec3
from .camera import Camera
from .extent import bounds, part_bounds, pieces, recentred, translated
from .joint import Intent, JointSpec, JointType, Mimic
from .kinematics import (
    ball_vector,
    joint_keys,
    joint_motion,
    joint_position,
    joint_value,
    link_poses,
)
from .mass import Inertial, inertial, is_too_light
from .object import AuthoredInertia, GeomSpec, Material, ObjectSpec, PartSpec, Role, Site
from .room import SupportOutline, SupportSurface
from .scale import scale, scaled_state
from .scene import (
    SceneObject,
    SceneSpec,
    read_scene,
    single_object_scene,
    support_frame,
    with_layout,
    world_poses,
)
from .shapes import (
    CSG,
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Extrusion,
    HollowBox,
    Lathe,
    Mesh,
    Operand,
    Prism,
    RoundedBox,
    Shape,
    Sphere,
    Sweep,
)
from .surface_pattern import SurfacePattern
from .tree import Box2D, Box3D, Cues, PartState, SceneTree, TreeNode

__all__ = [
    "CSG",
    "AuthoredInertia",
    "Box",
    "Box2D",
    "Box3D",
    "Camera",
    "Capsule",
    "Cues",
    "Cylinder",
    "Ellipsoid",
    "Extrusion",
    "GeomSpec",
    "HollowBox",
    "Inertial",
    "Intent",
    "JointKey",
    "JointSpec",
    "JointType",
    "Lathe",
    "Material",
    "Mesh",
    "Mimic",
    "Name",
    "Number",
    "ObjectSpec",
    "Operand",
    "PartSpec",
    "PartState",
    "Prism",
    "Quat",
    "Role",
    "RoundedBox",
    "SceneObject",
    "SceneSpec",
    "SceneTree",
    "Shape",
    "Site",
    "Spec",
    "Sphere",
    "SupportOutline",
    "SupportSurface",
    "SurfacePattern",
    "Sweep",
    "TreeNode",
    "Vec3",
    "ball_vector",
    "bounds",
    "inertial",
    "is_too_light",
    "joint_keys",
    "joint_motion",
    "joint_position",
    "joint_value",
    "link_poses",
    "part_bounds",
    "pieces",
    "read_scene",
    "recentred",
    "scale",
    "scaled_state",
    "single_object_scene",
    "support_frame",
    "translated",
    "with_layout",
    "world_poses",
]
