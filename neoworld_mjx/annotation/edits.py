"""Edits of an annotation. Each function returns a new, validated annotation."""

from typing import Any

from pydantic import ValidationError

from ..errors import SpecError
from ..spec import Box2D
from .annotation import GROUND, AnnotatedObject, Annotation


def find_object(annotation: Annotation, name: str) -> AnnotatedObject | None:
    """Return the object with the given name, or None if there is none."""
    return next((obj for obj in annotation.objects if obj.name == name), None)


def with_box(annotation: Annotation, box: Box2D) -> tuple[Annotation, str]:
    """Add an object with a box and default values; return the annotation and the object's name."""
    names = {obj.name for obj in annotation.objects}
    name = next(f"object_{k}" for k in range(1, len(names) + 2) if f"object_{k}" not in names)
    return _checked(annotation, (*annotation.objects, AnnotatedObject(name=name, box=box))), name


def with_change(annotation: Annotation, name: str, change: dict[str, Any]) -> Annotation:
    """Change fields of one object; if its name changes, update the parent of its children.

    Args:
        annotation: the current annotation.
        name: name of the object.
        change: new values, by field name of `AnnotatedObject`.

    Raises:
        SpecError: a value is invalid, or objects would support each other in a cycle.
    """
    new = change.get("name", name)
    objects = []
    for obj in annotation.objects:
        if obj.name == name:
            objects.append(obj.model_copy(update=change))
        elif obj.parent == name:
            objects.append(obj.model_copy(update={"parent": new}))
        else:
            objects.append(obj)
    return _checked(annotation, tuple(objects))


def without(annotation: Annotation, name: str) -> Annotation:
    """Remove an object; its children move to the ground."""
    remaining = (obj for obj in annotation.objects if obj.name != name)
    return _checked(
        annotation,
        tuple(
            o.model_copy(update={"parent": GROUND}) if o.parent == name else o for o in remaining
        ),
    )


def _checked(annotation: Annotation, objects: tuple[AnnotatedObject, ...]) -> Annotation:
    data = annotation.model_copy(update={"objects": objects}).model_dump()
    try:
        return Annotation.model_validate(data)
    except ValidationError as error:
        raise SpecError("; ".join(_reason(item) for item in error.errors())) from None


def _reason(item: Any) -> str:
    message = item["msg"].removeprefix("Value error, ")
    field = item["loc"][-1] if item["loc"] else None
    return f"{field}: {message}" if isinstance(field, str) else message
