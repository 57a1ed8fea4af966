"""Colliders and masses in the extras of glTF nodes, which has triangles alone.

A link's node states its colliders and the box of its visible meshes. A file whose meshes were
edited since has other boxes, and its colliders are derived from the meshes again.
"""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from ..spec import Mesh, ObjectSpec, PartSpec, Quat, Spec
from ..spec.base import Vec3
from ..spec.pose import pose
from ..spec.shapes import Shape
from .link_frames import transform
from .mechanism import LinkShape, Triangles

Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Transform from Z up to glTF's axes; frames of objects and links are Y up, too."""
KIND, OBJECT = "neoworld", "object"
"""Key and value in the extras of a node that is an object."""
COLLIDERS = "colliders"
"""Key in the extras of the node of a link."""
SAME_BOX = 1e-3
"""Largest difference of two boxes of the same meshes, over their diagonal."""


class StatedCollider(Spec):
    """A collider in the frame of its link, Z up."""

    shape: Shape
    pos: Vec3
    quat: Quat
    material: Annotated[str, Field(max_length=100)]
    density: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    """[kg/m^3]"""
    friction: Annotated[float, Field(ge=0, allow_inf_nan=False)]


class StatedColliders(Spec):
    """Extras of a link's node."""

    box: tuple[Vec3, Vec3]
    """Lowest and highest corner of the link's visible meshes in its frame [m]."""
    geoms: tuple[StatedCollider, ...] = Field(min_length=1, max_length=1000)


def extras_of(
    spec: ObjectSpec, part: PartSpec, visuals: Sequence[NDArray]
) -> dict[str, Any] | None:
    """Return the extras of a link; None if it has no visible mesh, or a mesh collides.

    Args:
        spec: the object.
        part: the link.
        visuals: vertices [n, 3] of its visible meshes, in its frame.
    """
    colliders = [geom for geom in part.geoms if geom.role != "visual"]
    if not visuals or not colliders or any(isinstance(geom.shape, Mesh) for geom in colliders):
        return None
    points = np.concatenate(visuals)
    return {
        COLLIDERS: {
            "box": [points.min(axis=0).tolist(), points.max(axis=0).tolist()],
            "geoms": [
                {
                    "shape": geom.shape.model_dump(mode="json"),
                    "pos": list(geom.pos),
                    "quat": list(geom.quat),
                    "material": material.name,
                    "density": material.density,
                    "friction": material.friction,
                }
                for geom in colliders
                for material in [spec.material(geom.material)]
            ],
        }
    }


def stated_shapes(extras: object, visuals: Sequence[Triangles], frame: NDArray) -> list[LinkShape]:
    """Return the colliders that a link's node states, or none if its meshes are others.

    Args:
        extras: untrusted entry of the node.
        visuals: the meshes below it, in its frame.
        frame: rigid transform [4, 4] of that frame to the object's.
    """
    if extras is None or not visuals:
        return []
    try:
        stated = StatedColliders.model_validate(extras)
    except (ValidationError, RecursionError):
        return []
    points = np.concatenate([vertices for vertices, _ in visuals])
    box = np.array([points.min(axis=0), points.max(axis=0)])
    if np.abs(box - stated.box).max() > SAME_BOX * np.linalg.norm(box[1] - box[0]):
        return []
    return [
        LinkShape(
            geom.shape,
            frame @ transform(pose(geom.pos, np.array(geom.quat))),
            "collision",
            friction=geom.friction,
            name=geom.material,
            density=geom.density,
        )
        for geom in stated.geoms
    ]
