"""Schema of the scene that the Blender process writes, which is untrusted and limited in size."""

import base64
import binascii
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

Text = Annotated[str, Field(max_length=200)]
Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Number = Annotated[float, Field(ge=-1e6, le=1e6)]
MAX_SHAPES, MAX_JOINTS = 3000, 300
MAX_REACH_M = 100.0
"""Largest allowed coordinate [m]."""


class _Data(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class BlenderMaterial(_Data):
    """A material, with values from its custom properties, or else from its Principled BSDF."""

    name: Text
    density: Number | None = None
    friction: Number | None = None
    like: Text | None = None
    rgb: Vector3 | None = None
    alpha: Number | None = None
    metallic: Number | None = None
    roughness: Number | None = None
    pattern: Text | None = None
    rgb2: Vector3 | None = None
    step: Number | None = None
    along: Text | None = None


class BlenderShape(_Data):
    """The triangles of an object in world coordinates [m], packed as base64."""

    name: Text
    part: Text
    role: Text
    convex: bool
    mass: Number | None = None
    """Mass [kg]; the masses of all shapes of a part add up."""
    materials: list[Text] = Field(max_length=64)
    """Name of the material in each slot; empty for an empty slot."""
    vertices: str
    """Vertices as 64-bit floats, shape [v, 3]."""
    faces: str
    """Vertex indices of each triangle as 32-bit integers, shape [f, 3]."""
    slots: str
    """Material slot of each triangle as a 32-bit integer, shape [f]."""

    def triangles(self) -> tuple[NDArray, NDArray, NDArray]:
        """Return vertices [m], shape [v, 3]; faces, shape [f, 3]; and slots, shape [f].

        Raises:
            ValueError: the arrays are malformed, or vertices are not finite or too far away.
        """
        vertices = _unpacked(self.vertices, "<f8", "vertices").reshape(-1, 3)
        faces = _unpacked(self.faces, "<i4", "faces").reshape(-1, 3).astype(np.int64)
        slots = _unpacked(self.slots, "<i4", "slots").astype(np.int64)
        if not np.isfinite(vertices).all() or np.abs(vertices).max(initial=0.0) > MAX_REACH_M:
            raise ValueError(f"vertices lie beyond {MAX_REACH_M:g} m; lengths are in metres")
        if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
            raise ValueError("a face names a vertex that is not there")
        if len(slots) != len(faces):
            raise ValueError("faces and slots are not as many")
        return vertices, faces, slots


class BlenderJoint(_Data):
    """A joint that an empty of the scene declares, in world coordinates."""

    name: Text
    type: Text
    parent: Text = ""
    child: Text = ""
    at: Vector3
    axis: Vector3 | Text
    range: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None
    opens: Vector3 | Text | None = None
    swing: Number | None = None
    damping: Number | None = None
    friction: Number | None = None
    stiffness: Number | None = None
    effort: Number | None = None
    velocity: Number | None = None
    mimic: Text | None = None
    multiplier: Number | None = None
    offset: Number | None = None
    after: Text | None = None
    """Names of the joints that must be open first, separated by commas."""


class BlenderSite(_Data):
    """A point of a part that an empty of the scene declares, in world coordinates."""

    name: Text
    part: Text
    at: Vector3


class BlenderError(_Data):
    """The exception that ended the program."""

    type: Annotated[str, Field(max_length=60)]
    message: Annotated[str, Field(max_length=600)]
    line: int | None = None
    column: int | None = None


class BlenderScene(_Data):
    """The scene after the program has run, or the program's error."""

    error: BlenderError | None = None
    name: Text = ""
    label: Text = ""
    materials: list[BlenderMaterial] = Field(default=[], max_length=MAX_SHAPES)
    shapes: list[BlenderShape] = Field(default=[], max_length=MAX_SHAPES)
    joints: list[BlenderJoint] = Field(default=[], max_length=MAX_JOINTS)
    sites: list[BlenderSite] = Field(default=[], max_length=MAX_SHAPES)


def _unpacked(text: str, kind: str, name: str) -> NDArray:
    try:
        return np.frombuffer(base64.b64decode(text, validate=True), kind)
    except (binascii.Error, ValueError):
        raise ValueError(f"{name} are no array") from None
