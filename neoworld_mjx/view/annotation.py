"""Annotation of a photograph: the camera, and the box, kind and support of each object."""

from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from ..errors import SpecError, choices
from ..io.names import UNIQUE, repeated
from ..program.supports import MATERIALS
from ..spec import Box2D, Camera, Name, PartState, Spec
from ..spec.base import Length, ObjectName
from ..spec.tree import Relation, name_on_cycle
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

    name: ObjectName
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
            raise ValueError(f"{UNIQUE}: {', '.join(twice)}")
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

    def find(self, name: str) -> AnnotatedObject | None:
        """Return the object with the given name, or None if there is none."""
        return next((obj for obj in self.objects if obj.name == name), None)

    def with_box(self, box: Box2D) -> tuple["Annotation", str]:
        """Add an object with a box and default values; return the annotation and its name."""
        numbers = range(1, len(self.objects) + 2)
        name = next(f"object_{k}" for k in numbers if self.find(f"object_{k}") is None)
        return self.with_fields(objects=(*self.objects, AnnotatedObject(name=name, box=box))), name

    def with_camera(self, change: dict[str, float]) -> "Annotation":
        """Change fields of the camera.

        Raises:
            SpecError: a value is invalid.
        """
        return self.with_fields(camera=self.camera.model_copy(update=change))

    def with_fields(self, **change: object) -> "Annotation":
        """Change fields of the annotation itself, such as the label of the ground.

        Raises:
            SpecError: a value is invalid.
        """
        data = self.model_copy(update=change).model_dump(warnings=False)
        try:
            return Annotation.model_validate(data)
        except ValidationError as error:
            raise SpecError("; ".join(_reason(item) for item in error.errors())) from None

    def with_change(self, name: str, change: dict[str, Any]) -> "Annotation":
        """Change fields of one object; if its name changes, update the parent of its children.

        Args:
            name: name of the object.
            change: new values, by field name of `AnnotatedObject`.

        Raises:
            SpecError: a value is invalid, or objects would support each other in a cycle.
        """
        objects = (
            obj.model_copy(update=change)
            if obj.name == name
            else _moved(obj, name, change.get("name", name))
            for obj in self.objects
        )
        return self.with_fields(objects=tuple(objects))

    def without(self, name: str) -> "Annotation":
        """Remove an object; its children move to the ground."""
        rest = (obj for obj in self.objects if obj.name != name)
        return self.with_fields(objects=tuple(_moved(obj, name, GROUND) for obj in rest))


def _moved(obj: AnnotatedObject, parent: str, new: str) -> AnnotatedObject:
    """Return an object on the parent `new` if its parent is `parent`."""
    return obj.model_copy(update={"parent": new}) if obj.parent == parent else obj


def _reason(item: Any) -> str:
    message = item["msg"].removeprefix("Value error, ")
    field = item["loc"][-1] if item["loc"] else None
    return f"{field}: {message}" if isinstance(field, str) else message
