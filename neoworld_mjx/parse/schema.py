"""Schema of the reasoner's response, and its conversion into a `SceneTree`.

The response is less nested than a scene tree. It uses pixels of the resized picture, degrees, and
words for the directions of tilts. Validation reports all errors of a response at once, in words for
the model. Names, docstrings and descriptions of the classes are part of the request, as in
`object_schema`.
"""

from pydantic import BaseModel, Field, ValidationError, model_validator

from ..errors import SpecError
from ..io.names import MAX_NAME, plain_text
from ..spec import SceneTree
from .object_schema import ParsedCamera, ParsedObject, ResponsePart, error_line
from .photo import Photo
from .response_to_tree import build_tree, corners, moved_with_camera


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
        if problems := _problems(self):
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
    """List the errors that the tree's own validation does not report."""
    spelled: dict[str, str] = {}
    parts = {obj.name: [part.part for part in obj.articulation] for obj in response.objects}
    problems = []
    for obj in response.objects:
        if spelled.setdefault(obj.name.lower(), obj.name) != obj.name:
            other = spelled[obj.name.lower()]
            problems.append(f"object {obj.name}: {other} differs by case alone")
        links = parts.get(obj.parent or "", [])
        if obj.parent_link is not None and obj.parent in parts and obj.parent_link not in links:
            problems.append(
                f"object {obj.name}: parent_link {plain_text(obj.parent_link, MAX_NAME)!r} is not "
                f"in the articulation of {obj.parent}, which has "
                f"{', '.join(links) or 'no movable parts'}"
            )
    return problems
