"""Base classes of commands: output flags, configuration, and evidence."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import UseAppendAction, arg

from ..errors import ConfigError, EvidenceError, PhotoError, SpecError

if TYPE_CHECKING:
    from ..config import Config
    from ..evidence.evidence_file import StatedEvidence

CommandResult = dict[str, Any]
"""JSON object that a command returns; its entry "passed" decides the exit code."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """Options of all commands."""

    ends_by_interrupt: ClassVar[bool] = False
    """If True, the command runs until Ctrl-C and then returns a result."""
    owns_stdout: ClassVar[bool] = False
    """If True, the command itself writes to stdout, such as a protocol."""
    inputs: ClassVar[tuple[str, ...]] = ("target", "config")
    """Fields with files or folders that are checked before slow modules are imported."""

    json: bool = False
    """Print the result as one JSON object on stdout, and everything else on stderr."""
    quiet: bool = False
    """Print no progress."""
    verbose: Annotated[bool, arg(aliases=("-v",))] = False
    """Print the whole result as YAML, and all progress messages."""
    debug: bool = False
    """Print the traceback of an error."""

    def check_inputs(self) -> None:
        """Check that the files and folders that the command reads exist.

        Raises:
            SpecError: one of them does not.
        """
        for path in (getattr(self, name, None) for name in self.inputs):
            if path is not None and not path.exists():
                raise SpecError(f"cannot read {path}: no such file or folder")

    def run(self) -> CommandResult:
        """Run the command and return its result.

        Raises:
            NeoWorldError: the input is invalid.
        """
        raise NotImplementedError

    def lines(self, result: CommandResult) -> list[str]:
        """Return the lines of a short summary of a result; by default, its entries."""
        return [
            f"{key}: {' x '.join(map(str, value)) if isinstance(value, list) else value}"
            for key, value in result.items()
        ]


@dataclass(frozen=True, kw_only=True)
class ConfiguredCommand(Command):
    """Options of commands with a configuration."""

    config: Path | None = None
    """YAML file of options that differ from the defaults."""
    set: UseAppendAction[tuple[str, ...]] = ()
    """One option as KEY=VALUE, such as --set refine.cem.population=64; repeatable."""

    def load_config(self, flags: dict[str, Any] | None = None) -> "Config":
        """Load the configuration.

        The options of --set override the file, and the command's flags override --set.

        Args:
            flags: values of the command's flags by the path of the option; None if a flag is not
                given.
        """
        from ..config import load_config, parse_yaml
        from ..io import set_file_bounds

        overrides: dict[str, Any] = {}
        for setting in self.set:
            key, equals, value = setting.partition("=")
            if not equals or not key:
                raise ConfigError(f"--set takes KEY=VALUE, such as seed=3, got {setting!r}")
            try:
                _put(overrides, key, parse_yaml(value))
            except ValueError:
                raise ConfigError(f"--set {key}: {value!r} is not a YAML value") from None
        for key, value in (flags or {}).items():
            if value is not None:
                _put(overrides, key, value)
        config = load_config(self.config, overrides)
        set_file_bounds(config.files)
        return config


def _put(tree: dict[str, Any], key: str, value: Any) -> None:
    *path, last = key.split(".")
    for name in path:
        inner = tree.setdefault(name, {})
        if not isinstance(inner, dict):
            raise ConfigError(f"--set {key}: {name} is set to a value already")
        tree = inner
    tree[last] = value


EVIDENCE = ("camera", "depth", "masks", "base", "evidence")
"""Fields of `EvidenceFlags` with files or folders."""


@dataclass(frozen=True, kw_only=True)
class EvidenceFlags:
    """Evidence that the user has; see docs/how-to/give-evidence.md."""

    camera: Path | None = None
    """Calibrated camera of the photograph: JSON or YAML, ROS camera_info, BOP, nerfstudio's
    transforms.json, a folder of COLMAP, or K.npy."""
    depth: Path | None = None
    """Depth image of the photograph's view: a 16-bit PNG in millimeters, or .npy in meters."""
    masks: Path | None = None
    """Masks of the objects: an image of numbers, or a folder with a PNG of each object."""
    gravity: tuple[float, float, float] | None = None
    """Direction of gravity, in the camera's frame; 0 1 0 is a level camera."""
    base: Path | None = None
    """Pose of the camera in a robot's base frame, in which the scene is then expressed."""
    ground: float | None = None
    """Height of the scene's plane z = 0, such as the table's top, in the base frame [m]."""
    object: UseAppendAction[tuple[str, ...]] = ()
    """Asset in place of an object's program: NAME=FILE, a URDF, MJCF, glTF or mesh file in meters;
    repeatable."""
    evidence: Path | None = None
    """YAML file that names all of these; other flags take precedence."""

    def stated(self, photos: tuple[Path, ...] = ()) -> "StatedEvidence | None":
        """Return the stated evidence; None if no flag is given.

        Args:
            photos: further photographs of the scene.
        """
        from ..evidence.evidence_file import StatedEvidence, read_stated

        flags: dict[str, Any] = {
            name: str(value)
            for name in ("camera", "depth", "masks", "base")
            if (value := getattr(self, name)) is not None
        }
        for name in ("gravity", "ground"):
            if (value := getattr(self, name)) is not None:
                flags[name] = value
        if self.object:
            flags["objects"] = dict(map(_named_file, self.object))
        if photos:
            flags["views"] = [{"photo": str(photo)} for photo in photos]
        own = StatedEvidence(**flags)
        if self.evidence is not None:
            return read_stated(self.evidence).overridden(own)
        return own if flags else None


def check_photo(photo: Path) -> None:
    """Check that a photograph exists; a name without a suffix may be that of an example.

    Raises:
        PhotoError: it does not.
    """
    if photo.suffix and not photo.exists():
        raise PhotoError(f"{photo}: no such file; check the path of the photograph")


def _named_file(value: str) -> tuple[str, str]:
    name, equals, file = value.partition("=")
    if not (equals and file and re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII)):
        raise EvidenceError(f"--object: got {value!r}, expected NAME=FILE, as in cup=cup.urdf")
    return name, file
