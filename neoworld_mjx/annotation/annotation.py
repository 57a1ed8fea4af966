"""Annotation of a photograph: the camera, and the box, kind and support of each object."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..errors import choices
from ..io.names import repeated
from ..program.materials import MATERIALS
from ..spec import Box2D, Camera, Name, PartState, Spec
from ..spec.base import Length
from ..spec.forest import name_on_cycle
from ..spec.tree import Relation
from ..templates import templates

GROUND = "ground"
"""Name of the support at z = 0 that every annotation has."""
WRITTEN_BY_MODEL = "left to a model"
"""Kind of an object whose program a model writes."""
EXISTING_PROGRAM = "as it is"
"""Kind of an object that keeps its existing program."""
SHAPES = ("box", "cylinder", "ball", "bowl", "cup")
"""Kinds of objects without a template."""


class AnnotatedObject(Spec):
    """Object that a person has marked with a 2D box and named."""

    name: Name
    label: str = Field(default="", max_length=100)
    kind: str = "box"
    """A template, one of `SHAPES`, `WRITTEN_BY_MODEL` or `EXISTING_PROGRAM`."""
    box: Box2D
    """2D box in the upright photograph at its original size [px]."""
    parent: Name = GROUND
    relation: Relation = "on"
    support: bool = False
    """If True, the object is a support of the environment, such as a shelf, and never moves."""
    fixed_base: bool = False
    size: tuple[Length, Length, Length] | None = None
    """Edge lengths along the object's x (back to front), y and z axes [m]; None if unknown."""
    yaw_deg: Annotated[float, Field(ge=-360, le=360)] = 180.0
    """Heading of the object's front, seen from above [deg]; at 180, the front faces the camera."""
    material: str = "plastic"
    """Material of the object if its kind is one of `SHAPES`."""
    parts: tuple[PartState, ...] = ()
    """Movable parts, each with its opening in the photograph."""

    @model_validator(mode="after")
    def _check_kind_and_material(self) -> "AnnotatedObject":
        kinds = [*SHAPES, WRITTEN_BY_MODEL, EXISTING_PROGRAM, *templates()]
        if self.kind not in kinds:
            raise ValueError(f"object {self.name}: kind: {choices(self.kind, kinds)}")
        if self.material not in MATERIALS:
            raise ValueError(f"object {self.name}: material: {choices(self.material, MATERIALS)}")
        return self


class Annotation(Spec):
    """Annotation of a photograph by a person."""

    camera: Camera
    ground: Literal["floor", "table top", "counter", "ground"] = "table top"
    """Label of the support at z = 0."""
    objects: tuple[AnnotatedObject, ...] = ()

    @model_validator(mode="after")
    def _check_names_and_parents(self) -> "Annotation":
        names = [GROUND, *(obj.name for obj in self.objects)]
        if twice := repeated(names):
            raise ValueError(f"names must be unique, repeated: {', '.join(twice)}")
        for obj in self.objects:
            if obj.parent not in names:
                raise ValueError(f"object {obj.name}: parent: {choices(obj.parent, names)}")
        on_cycle = name_on_cycle(self.parents())
        if on_cycle is not None:
            raise ValueError(f"objects support each other in a cycle through {on_cycle}")
        return self

    def parents(self) -> dict[str, str | None]:
        """Return the name of each object's parent, by object name; None stands for the ground."""
        return {obj.name: None if obj.parent == GROUND else obj.parent for obj in self.objects}
