"""Schema of the scene that Blender's process writes after a program: untrusted, bounded in size."""

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
"""Largest allowed coordinate."""


class _Data(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class BlenderMaterial(_Data):
    """A material as its custom properties define it, or else its Principled BSDF."""

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
    """Mass [kg], added to that of the whole part."""
    materials: list[Text] = Field(max_length=64)
    """Names by slot; empty for an empty slot."""
    vertices: str
    """[v, 3], 64-bit floats."""
    faces: str
    """[f, 3], 32-bit integers."""
    slots: str
    """Slot of each face [f], 32-bit integers."""

    def triangles(self) -> tuple[NDArray, NDArray, NDArray]:
        """Return vertices [v, 3] m, faces [f, 3] and slots [f].

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
    """A joint that an empty declares, in world coordinates."""

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
    """Names of joints, separated by commas."""


class BlenderSite(_Data):
    """A point of a part that an empty declares."""

    name: Text
    part: Text
    at: Vector3


class BlenderError(_Data):
    """Exception that ended the program."""

    type: Annotated[str, Field(max_length=60)]
    message: Annotated[str, Field(max_length=600)]
    line: int | None = None
    column: int | None = None


class BlenderScene(_Data):
    """Scene after the program's run, or the program's error."""

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
