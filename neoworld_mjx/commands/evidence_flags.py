"""Flags of the commands that take evidence: camera, depths and masks of a photograph, objects."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import UseAppendAction

from ..errors import EvidenceError

if TYPE_CHECKING:
    from ..evidence.evidence_file import StatedEvidence


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


def _named_file(value: str) -> tuple[str, str]:
    name, equals, file = value.partition("=")
    if not (equals and file and re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII)):
        raise EvidenceError(f"--object: got {value!r}, expected NAME=FILE, as in cup=cup.urdf")
    return name, file
