"""Colliders and densities in the extras of glTF nodes, because glTF stores only triangles.

The extras of a link's node state the link's colliders and the bounding box of its visible meshes.
If the meshes have been edited, the bounding box no longer matches, and the reader derives the
colliders from the meshes.
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
"""Transform from Z-up axes to glTF's Y-up axes. Frames of objects and links are also Y-up."""
KIND, OBJECT = "neoworld", "object"
"""Key and value that mark a node as an object, in the node's extras."""
COLLIDERS = "colliders"
"""Key of the colliders in the extras of a link's node."""
SAME_BOX = 1e-3
"""Largest difference between two bounding boxes of the same meshes, relative to the diagonal."""


class StatedCollider(Spec):
    """Collider of a link, in the link's frame with Z up."""

    shape: Shape
    pos: Vec3
    quat: Quat
    material: Annotated[str, Field(max_length=100)]
    density: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    """Density [kg/m^3]."""
    friction: Annotated[float, Field(ge=0, allow_inf_nan=False)]


class StatedColliders(Spec):
    """Colliders that the extras of a link's node state."""

    box: tuple[Vec3, Vec3]
    """Lowest and highest corners of the bounding box of the link's visible meshes, in the link's
    frame [m]."""
    geoms: tuple[StatedCollider, ...] = Field(min_length=1, max_length=1000)


def extras_of(
    spec: ObjectSpec, part: PartSpec, visuals: Sequence[NDArray]
) -> dict[str, Any] | None:
    """Return the extras of a link's node.

    The result is None if the link has no visible mesh or no collider, or if a collider is a mesh.

    Args:
        spec: the object.
        part: the link.
        visuals: vertices of each visible mesh of the link, in the link's frame [m], shape [n, 3].
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
    """Return the colliders that a link's node states.

    The list is empty if the extras are missing or invalid, or if the link's meshes have changed.

    Args:
        extras: untrusted value of the key `COLLIDERS` in the node's extras.
        visuals: the link's meshes, in the link's frame.
        frame: rigid transform from the link's frame to the object's frame, shape [4, 4].
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
