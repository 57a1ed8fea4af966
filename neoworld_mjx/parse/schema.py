"""Schema of the reasoner's response, and its conversion into a `SceneTree`.

The response is less nested than a scene tree. It uses pixels of the resized picture, degrees, and
words for the directions of tilts. Validation reports all errors of a response at once, in words for
the model. Names, docstrings and descriptions of the classes are part of the request, as in
`object_schema`.
"""

from pydantic import BaseModel, Field, ValidationError, model_validator

from ..errors import SpecError
from ..io.names import MAX_NAME, NAME_RULE, RESERVED, is_name, plain_text
from ..spec import SceneTree
from .camera_change import moved_with_camera
from .object_schema import ParsedCamera, ParsedObject
from .photo import Photo
from .response_bounds import out_of_bounds, too_long
from .response_to_tree import build_tree, corners
from .room_schema import ResponsePart, error_line, support_problems


class ParsedScene(ResponsePart):
    """The scene in the photograph."""

    observations: str = Field(
        default="",
        description="First, in a few sentences: what supports what, what hides what, and the known "
        "sizes from which camera and distances are estimated.",
    )
    camera: ParsedCamera
    objects: list[ParsedObject]

    @model_validator(mode="after")
    def _consistent(self) -> "ParsedScene":
        problems = list(_problems(self))
        if problems:
            raise ValueError("; ".join(problems))
        try:
            # These checks do not depend on the size of the picture.
            build_tree(self.camera, self.objects, (1.0, 1.0), (1, 1), clip=False)
        except ValidationError as error:
            raise ValueError(error_line(error)) from None
        return self


class SceneCorrection(ResponsePart):
    """Changes of an earlier response."""

    observations: str = Field(
        default="", description="In a few sentences: what is corrected, and why; or what is not."
    )
    camera: ParsedCamera | None = Field(
        default=None, description="The complete camera if any of its numbers changes; else null."
    )
    objects: list[ParsedObject] = Field(
        default_factory=list,
        description="Only the objects that change or are new, each complete; an object replaces "
        "the earlier one of the same name.",
    )
    removed: list[str] = Field(
        default_factory=list, description="Names of the earlier objects that do not exist."
    )

    def applied(self, earlier: ParsedScene, size: tuple[int, int]) -> ParsedScene:
        """Return the corrected response; objects that are not listed again keep their pixels.

        Args:
            earlier: the response to correct.
            size: width and height of the picture that the model saw [px].

        Raises:
            ValidationError: the corrected scene is inconsistent; the messages are written for the
                model.
        """
        changed = {obj.name: obj for obj in self.objects}
        names = [obj.name for obj in earlier.objects]
        remaining = [changed.get(o.name, o) for o in earlier.objects if o.name not in self.removed]
        if self.camera is not None:
            remaining = moved_with_camera(
                remaining, earlier.camera, self.camera, size, placed=changed
            )
        added = [obj for obj in self.objects if obj.name not in names]
        data = {
            "observations": self.observations or earlier.observations,
            "camera": self.camera or earlier.camera,
            "objects": [*remaining, *added],
        }
        # Validate objects again, because their parents and occluders must exist.
        return ParsedScene.model_validate({key: _plain(value) for key, value in data.items()})


def _plain(value: object) -> object:
    if isinstance(value, BaseModel):
        return value.model_dump()
    return [_plain(entry) for entry in value] if isinstance(value, list) else value


def to_tree(response: ParsedScene, photo: Photo) -> SceneTree:
    """Convert a response into a scene tree in pixels of the upright original.

    2D boxes are clipped at the picture's edges.

    Args:
        response: the response, with boxes in pixels of the resized picture.
        photo: the photograph.

    Raises:
        SpecError: a box lies outside the picture, or the tree is invalid; the message is written
            for the model.
    """
    size, original = photo.size, photo.original_size
    outside = [
        f"object {obj.name}: box {corners(obj.box)} lies outside the picture, which is "
        f"{size[0]} x {size[1]} pixels"
        for obj in response.objects
        if obj.box.left >= size[0]
        or obj.box.top >= size[1]
        or obj.box.right <= 0
        or obj.box.bottom <= 0
    ]
    if outside:
        raise SpecError("; ".join(outside))
    per_pixel = (original[0] / size[0], original[1] / size[1])
    try:
        return build_tree(response.camera, response.objects, per_pixel, original, clip=True)
    except ValidationError as error:
        raise SpecError(error_line(error)) from None


def _problems(response: ParsedScene) -> list[str]:
    """List the errors that the tree's own validation would not report clearly."""
    problems = list(too_long(response))
    if problems:
        return problems[:1]  # Further errors would concern every object.
    if not response.objects:
        problems.append("objects is empty: list at least the supports")
    names = [obj.name for obj in response.objects]
    problems.extend(_same_names(names))
    problems.extend(out_of_bounds(response))
    for obj in response.objects:
        where = f"object {plain_text(obj.name, MAX_NAME)}"
        if not is_name(obj.name):
            problems.append(f"{where}: a name has {NAME_RULE}")
        if obj.name in RESERVED:
            problems.append(f"{where}: MuJoCo reserves this name, choose another")
        if obj.box.left >= obj.box.right or obj.box.top >= obj.box.bottom:
            problems.append(
                f"{where}: box needs left < right and top < bottom, got {corners(obj.box)}"
            )
        others = [("parent", obj.parent), ("leans_on", obj.leans_on)]
        others += [("occluded_by", other) for other in obj.occluded_by]
        if obj.leans_on is not None and obj.relation != "leaning":
            problems.append(f"{where}: leans_on is for the relation leaning only")
        if obj.leans_on in (obj.name, obj.parent) and obj.leans_on is not None:
            problems.append(
                f"{where}: leans_on names what it leans against, not itself or what it stands on"
            )
        for field, other in others:
            if other is not None and other not in names:
                problems.append(
                    f"{where}: {field} {plain_text(other, MAX_NAME)!r} is no object; they are "
                    f"{plain_text(', '.join(names), 2000)}"
                )
        for part in obj.articulation:
            if not is_name(part.part):
                problems.append(
                    f"{where}: part {plain_text(part.part, MAX_NAME)!r} needs a name of {NAME_RULE}"
                )
        declared = (obj.environment, obj.furniture, obj.outline, obj.surface)
        problems.extend(f"{where}: {problem}" for problem in support_problems(*declared))
        problems.extend(_link_problems(obj, response))
    return problems


def _same_names(names: list[str]) -> list[str]:
    """Return an error for each name that differs from an earlier one only by case."""
    spelled: dict[str, str] = {}
    return [
        f"object {plain_text(name, MAX_NAME)}: {spelled[name.lower()]} differs by case alone"
        for name in names
        if spelled.setdefault(name.lower(), name) != name
    ]


def _link_problems(obj: ParsedObject, response: ParsedScene) -> list[str]:
    parent = next((other for other in response.objects if other.name == obj.parent), None)
    if obj.parent_link is None or parent is None:
        return []
    parts = [part.part for part in parent.articulation]
    if obj.parent_link in parts:
        return []
    return [
        f"object {obj.name}: parent_link {obj.parent_link!r} is not in the articulation of "
        f"{parent.name}, which has {', '.join(parts) or 'no movable parts'}"
    ]
