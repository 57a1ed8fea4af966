"""Scenes as declarations: programs, parameters and poses, one YAML file a scene."""

import functools
import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError, model_validator

from neoworld_mjx.config import read_yaml
from neoworld_mjx.errors import ConfigError, SpecError, choices
from neoworld_mjx.io.text_files import validation_message
from neoworld_mjx.spec import Camera, Spec
from neoworld_mjx.spec.base import JointKey, Name, Number, Quat, Vec3
from neoworld_mjx.spec.pose import IDENTITY
from neoworld_mjx.spec.room import SupportOutline, SupportSurface, SurfacePattern
from neoworld_mjx.spec.tree import Relation
from neoworld_mjx.templates import Template, read_template, template, templates

SCENES, ARRANGEMENTS, PROGRAMS = (
    Path(__file__).parent / name for name in ("scenes", "arrangements", "programs")
)
Room = Literal[
    "tabletop", "kitchen", "desk", "workshop", "laboratory", "bathroom", "shelf", "floor"
]
Value = float | int | str


class CameraDeclaration(Spec):
    """The camera of a scene's picture, above the world's origin and looking along +x."""

    height: Number
    """Above z = 0 [m]."""
    pitch_deg: Annotated[float, Field(ge=-90, le=90)]
    fovy_deg: Annotated[float, Field(gt=5, lt=120)]
    roll_deg: Number = 0.0

    def camera(self, width: int = 640, height: int = 480) -> Camera:
        """Return the camera with a picture of that size [px]."""
        return Camera(
            width=width,
            height_px=height,
            fovy=math.radians(self.fovy_deg),
            height=self.height,
            pitch=math.radians(self.pitch_deg),
            roll=math.radians(self.roll_deg),
        )


class SupportDeclaration(Spec):
    """A slab or table of the environment."""

    name: Name
    label: str
    size: Vec3
    at: Vec3
    """Center of its bottom in the world [m]."""
    yaw_deg: Number = 0.0
    outline: SupportOutline = SupportOutline()
    surface: SupportSurface = SupportSurface(material="oak", pattern=SurfacePattern(kind="grain"))


class ObjectDeclaration(Spec):
    """An object: its program and its pose."""

    name: Name
    program: Name
    """Name in `programs/`, or of a template."""
    set: dict[Name, Value] = {}
    """Parameters of the program that differ from its defaults."""
    parent: Name
    """Its parent."""
    link: Name | None = None
    """Supporting part of the parent, such as an open drawer."""
    relation: Relation = "on"
    at: Vec3
    """Origin in the parent's frame [m]."""
    yaw_deg: Number = 0.0
    tilt: Quat = IDENTITY
    """Rotation before yaw."""
    joints: dict[JointKey, Number] = {}
    """Joint values [rad or m]; the others are at 0."""
    fixed: bool = False
    """True if it is fixed to its parent."""
    environment: bool = False
    """True if it is static furniture of the room."""
    scale: Annotated[float, Field(gt=0.05, lt=20)] = 1.0
    """Isotropic factor on the program's size, for toys."""


class SceneDeclaration(Spec):
    """A scene."""

    name: Name
    room: Room
    caption: str
    """Contents, in one sentence."""
    camera: CameraDeclaration
    supports: tuple[SupportDeclaration, ...] = Field(min_length=1)
    objects: tuple[ObjectDeclaration, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _carried(self) -> "SceneDeclaration":
        known = [support.name for support in self.supports]
        for item in self.objects:
            if item.name in known:
                raise ValueError(f"names must be unique, repeated: {item.name}")
            if item.parent not in known:
                raise ValueError(f"object {item.name}: {item.parent!r} must come before it")
            known.append(item.name)
        return self

    @property
    def tabletop(self) -> bool:
        """True if it is one of the tabletop subset."""
        return self.room == "tabletop"

    def movable(self) -> tuple[ObjectDeclaration, ...]:
        """Return the objects that a method has to place."""
        return tuple(item for item in self.objects if not item.environment)


def read_declaration(path: Path) -> SceneDeclaration:
    """Read a scene's YAML file, whose name is the scene's.

    Raises:
        SpecError: it cannot be read, or is no declaration of a scene.
    """
    try:
        content = read_yaml(path, "scene")
        return SceneDeclaration.model_validate({"name": path.stem, **content})
    except (ConfigError, TypeError) as error:
        raise SpecError(f"{path} is no YAML of a scene: {error}") from None
    except ValidationError as error:
        raise SpecError(f"{path}: {validation_message(error, SceneDeclaration)}") from None


@functools.cache
def declarations(folder: Path = SCENES) -> dict[str, SceneDeclaration]:
    """Read the thirty scenes, or the scenes of another folder, by name."""
    return {path.stem: read_declaration(path) for path in sorted(folder.glob("*.yaml"))}


def declaration(name: str) -> SceneDeclaration:
    """Return one of the thirty scenes or of the arrangements.

    Raises:
        SpecError: there is no such name.
    """
    every = declarations() | declarations(ARRANGEMENTS)
    if name not in every:
        raise SpecError(f"scene: {choices(name, every)}")
    return every[name]


@functools.cache
def _small_programs() -> dict[str, Template]:
    return {path.stem: read_template(path) for path in sorted(PROGRAMS.glob("*.py"))}


def template_of(item: ObjectDeclaration) -> Template:
    """Return the template that an object is an instance of.

    Raises:
        SpecError: there is no such name.
    """
    small = _small_programs()
    if item.program in small:
        return small[item.program]
    if item.program not in templates():
        names = [*small, *templates()]
        raise SpecError(f"object {item.name}, program: {choices(item.program, names)}")
    return template(item.program)


def program_of(item: ObjectDeclaration) -> str:
    """Return the text of an object's program.

    Raises:
        SpecError: there is no such program or parameter, or a value is out of range.
    """
    return template_of(item).program(item.set)
