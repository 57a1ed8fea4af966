"""Film strips of the motion of a ground-truth joint and of its reconstructed partner."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.errors import ConfigError, SpecError
from neoworld_mjx.mllm import Picture
from neoworld_mjx.render import View, render_plain, visible_vertices
from neoworld_mjx.render.viewpoints import with_open_joints
from neoworld_mjx.spec import JointSpec, ObjectSpec, SceneObject, SceneSpec
from neoworld_mjx.spec.opening import opening_value, prerequisite_state
from neoworld_mjx.verify.checking import object_of_file

from ..measures import JointMeasure, joint_measure, truth_of
from ..measures.joint_measure import joint_partners
from ..measures.object_truth import Front, ObjectTruth, canonical, quarter_turns
from ..objects.made_objects import object_files

FRAMES = 5
WIDTH, HEIGHT, GAP = 256, 224, 6
"""Size of a frame and of the gap between frames [px]."""
ASIDE_DEG, ELEVATION_DEG = 35.0, 28.0
"""Direction of the camera: from the front or the back to the side of the moving part, and from
above."""
BEHIND = 0.3
"""Distance behind the center at which a moving part is seen from the back, over the object's
depth."""
LEAST_CHANGED = 1e-3
"""Minimum share of changed pixels of a visible motion."""
WHOLE_TURN = 0.8
"""Share of a turn that an endless joint shows."""


@dataclass(frozen=True)
class JointedPair:
    """A reconstructed object, the ground-truth object, and the pairing of their joints."""

    name: str
    made: ObjectSpec | None
    """None if it was not reconstructed."""
    true: ObjectSpec
    front: Front
    """Of the ground-truth object."""
    why: str = "there is no made object of this name"
    """Reason why it was not reconstructed."""

    @property
    def truth(self) -> ObjectTruth:
        """The ground-truth joints, as the measures by geometry take them."""
        return truth_of(self.true).model_copy(update={"front": self.front})

    @property
    def partners(self) -> dict[str, str]:
        """The reconstructed joint by the ground-truth joint's name."""
        return {} if self.made is None else joint_partners(self.made, self.truth)

    def geometry(self) -> JointMeasure:
        """Return the measure of the joints by geometry."""
        empty = ObjectTruth(name=self.name, box=self.truth.box)
        return joint_measure(self.made if self.made is not None else empty, self.truth)

    def strips(self, true: str, made: str) -> list[Picture]:
        """Draw the strips of a ground-truth joint ("first") and a reconstructed one ("second").

        Both are seen from the side of the ground-truth joint's part. If its motion is not visible
        because the part is inside, all other joints of both objects are opened; if that does not
        help, the objects are seen from the other side.
        """
        assert self.made is not None
        turns = np.pi / 2 * quarter_turns(self.front)
        side = _side(canonical(self.truth), true)
        for azimuth, others_open in ((side, False), (side, True), (-side, True)):
            first = joint_frames(self.true, true, azimuth - turns, others_open=others_open)
            if motion_is_seen(first):
                break
        second = joint_frames(self.made, made, azimuth, others_open=others_open)
        return [Picture.of("first", _beside(first)), Picture.of("second", _beside(second))]

    def true_joint(self, name: str) -> JointSpec:
        """Return a ground-truth joint by name."""
        return self.true.joint(name)

    def made_type(self, name: str) -> str:
        """Return the type of a reconstructed joint."""
        assert self.made is not None
        return self.made.joint(name).type


def object_pairs(
    made: Path | None, truth: Path | None, options: ProgramOptions, *, front: Front = "+x"
) -> list[JointedPair]:
    """Read a reconstructed and a ground-truth object, or two folders of them with the same names.

    A ground-truth object without a valid reconstruction is a pair too: all its joints are missed.

    Args:
        made: file of an object, or folder of files or of folders such as a run's `objects`.
        truth: the same of the ground-truth objects.
        options: of programs.
        front: direction in the ground-truth objects' frame in which their fronts face.

    Raises:
        ConfigError: a path is not given, or only one of them is a folder.
        SpecError: a path is missing, or a ground-truth object cannot be read.
    """
    if made is None or truth is None:
        raise ConfigError("joint-videos needs --made and --truth: objects, or folders of objects")
    for path in (made, truth):
        if not path.exists():
            raise SpecError(f"there is no {path}")
    if made.is_file() and truth.is_file():
        files = {truth.stem: (made, truth)}
    elif made.is_dir() and truth.is_dir():
        made_files = object_files(made)
        files = {name: (made_files.get(name), path) for name, path in object_files(truth).items()}
    else:
        raise ConfigError("--made and --truth must both be files or both be folders")
    pairs = []
    for name, (own_file, true_file) in files.items():
        pair = JointedPair(name, None, object_of_file(true_file, options), front)
        if own_file is not None:
            try:
                pair = replace(pair, made=object_of_file(own_file, options))
            except SpecError as error:
                pair = replace(pair, why=str(error))
        pairs.append(pair)
    return pairs


def joint_frames(
    spec: ObjectSpec, name: str, azimuth: float, *, others_open: bool = False
) -> list[NDArray]:
    """Render a joint from closed to open.

    Prerequisite joints are open. For a mimic joint, the joint that it follows moves.

    Args:
        spec: the object.
        name: of a joint of it, no ball joint.
        azimuth: direction of the camera in the object's frame [rad].
        others_open: whether all other joints with limits are open, too.

    Returns:
        Frames uint8 [h, w, 3], all from one view that shows the whole object in each.
    """
    joint = spec.joint(name)
    while joint.mimic is not None:
        joint = spec.joint(joint.mimic.joint)
    share = WHOLE_TURN if joint.type == "continuous" else 1.0
    alone = SceneObject(name=spec.name, spec=spec)
    others = with_open_joints(SceneSpec(objects=(alone,)), 1.0).objects[0].joint_state
    others = {**(others if others_open else {}), **prerequisite_state(spec, joint)}
    scenes = [
        SceneSpec(
            objects=(alone.model_copy(update={"joint_state": {**others, joint.name: value}}),)
        )
        for value in (opening_value(joint, share * k / (FRAMES - 1)) for k in range(FRAMES))
    ]
    points = [visible_vertices(spec, scene.objects[0].joint_state) for scene in scenes]
    view = View.framing(
        np.vstack(points),
        width=WIDTH,
        height=HEIGHT,
        azimuth=azimuth,
        elevation=np.radians(ELEVATION_DEG),
        margin=1.05,
    )
    return [render_plain(scene, view) for scene in scenes]


def motion_is_seen(frames: Sequence[NDArray]) -> bool:
    """Return True if a frame differs visibly from the first."""
    changed = [(frame != frames[0]).any(axis=2).mean() for frame in frames[1:]]
    return bool(max(changed) > LEAST_CHANGED)


def _side(truth: ObjectTruth, joint: str) -> float:
    """Return the azimuth [rad] from which the part of a joint is seen; +x is the front."""
    box = next(item.moving_box for item in truth.joints if item.name == joint)
    low, high = np.array(truth.box)
    x, y, _ = (np.mean(np.array(box), axis=0) - (low + high) / 2) / np.maximum(high - low, 1e-9)
    front = x > -BEHIND
    aside = np.radians(ASIDE_DEG if y > 0.05 else -ASIDE_DEG)
    return float(aside if front else np.pi - aside)


def _beside(frames: Sequence[NDArray]) -> NDArray:
    gap = np.full((HEIGHT, GAP, 3), 255, np.uint8)
    return np.concatenate([part for frame in frames for part in (frame, gap)][:-1], axis=1)
