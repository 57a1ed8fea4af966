"""Openings of joints: errors before and after the alignment, on scenes with one open joint.

Few objects of the thirty scenes are open. Therefore every hinge and slide of the movable objects is
opened in turn, if the camera sees the opening and the moving part does not collide. Initial scenes
have errors of openings, ranges, positions, headings, sizes, 2D boxes and the camera. Initial scenes
with odd numbers also have errors of programs.
"""

import math
import zlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from neoworld_mjx.align.align import align
from neoworld_mjx.align.rasterize import draw_scene
from neoworld_mjx.align.unknowns import CAMERA, Unknowns
from neoworld_mjx.config import AlignOptions
from neoworld_mjx.physics.colliders import object_depths, start_state
from neoworld_mjx.spec import Box2D, JointSpec, SceneObject, SceneSpec
from neoworld_mjx.spec.opening import opening_share, opening_value, with_prerequisites
from neoworld_mjx.sweeps.intervals import ratio_interval

from ..dataset.declaration import declaration
from ..dataset.truth_scene import truth_scene
from ..fidelity.rendered_scenes import photograph
from ..noise.initial_scenes import noise_number, wrong_shapes
from ..noise.joint_noise import RANGE
from ..noise.parse_noise import OPENING, NoiseLog
from ..rows import Row
from .layout_errors import layout_errors

OPENINGS = (0.3, 0.9)
"""Minimum and maximum opening in the ground truth, as a fraction of the range."""
SEEN_PX, SEEN_M = 300, 0.01
"""The camera sees an opening if it changes the depth by more than SEEN_M [m] in at least SEEN_PX
pixels of an image with 640 columns."""
COLLIDES_M = 0.003
"""Penetration with another object above which a joint is not opened [m]."""
BOX_PX = 2.0
"""Standard deviation of the sides of 2D boxes [px]."""
CAMERA_SD = (math.radians(1.0), math.radians(0.5), 0.03, 0.03)
"""Standard deviations of pitch [rad], roll [rad], log focal length and log height."""
PLACE_SD = (0.015, 0.015, math.radians(2.0), 0.02)
"""Standard deviations of an object's position x and y [m], heading [rad] and log scale."""
STAGES = ("composed", "without", "aligned")
"""The initial scene, the scene aligned without joints, and the scene aligned with joints."""


class OpeningRow(Row):
    """Result for one opened joint and one initial scene."""

    scene: str
    object: str
    joint: str
    start: int
    range: float
    """Range of the joint in the ground truth [rad or m]."""
    truth: float
    """Position of the joint in the ground truth [rad or m]."""
    value: dict[str, float]
    """Position of the joint [rad or m] by stage; 0 if the joint has no value."""
    deviation: float | None
    """Standard deviation that the alignment reports [rad or m]; None if the joint was no unknown of
    the alignment."""
    errors: dict[str, dict[str, float]]
    """`layout_errors` by stage."""

    def error(self, stage: str) -> float:
        """Return the error of the joint's position at a stage, as a fraction of the true range."""
        return abs(self.value[stage] - self.truth) / self.range


def opened_scenes(name: str) -> Iterator[tuple[SceneObject, JointSpec, SceneSpec]]:
    """Yield the object, the joint and the photographed scene for each joint that can be opened.

    Joints that are open in the benchmark's scene keep their values.
    """
    declared = truth_scene(declaration(name))
    for item in declared.objects:
        for joint in item.spec.joints:
            if item.environment or joint.mimic or joint.type not in ("revolute", "prismatic"):
                continue
            scene = with_open(declared, item, joint)
            others = _depths(with_closed(declared, item, joint), item.name)
            collides = any(
                depth > max(COLLIDES_M, others.get(pair, 0.0))
                for pair, depth in _depths(scene, item.name).items()
            )
            if not collides and _is_seen(scene, with_closed(scene, item, joint)):
                yield scene.object(item.name), joint, with_boxes(scene)


def with_boxes(scene: SceneSpec) -> SceneSpec:
    """Return a scene in which each object's 2D box bounds its visible pixels."""
    assert scene.camera is not None
    width = scene.camera.width
    owner, objects = draw_scene(scene, scene.camera, width).owner, []
    for k, item in enumerate(scene.objects):
        rows, columns = np.nonzero(owner == k)
        box = None
        if len(rows) and not item.environment:
            ends = columns.min(), rows.min(), columns.max() + 1, rows.max() + 1
            box = Box2D(**dict(zip(("x0", "y0", "x1", "y1"), map(float, ends), strict=True)))
        objects.append(item.model_copy(update={"box2d": box}))
    return scene.model_copy(update={"objects": tuple(objects)})


def with_open(scene: SceneSpec, item: SceneObject, joint: JointSpec) -> SceneSpec:
    """Return a scene with a joint open by a random fraction, which depends only on the names."""
    if item.joint_state.get(joint.name, 0.0):
        return scene
    rng = np.random.default_rng(zlib.crc32(f"{scene.name}/{item.name}/{joint.name}".encode()))
    value = opening_value(joint, float(rng.uniform(*OPENINGS)))
    state = with_prerequisites(item.spec, item.joint_state | {joint.name: value}, opening=True)
    return _replaced(scene, item.model_copy(update={"joint_state": state}))


def with_closed(scene: SceneSpec, item: SceneObject, joint: JointSpec) -> SceneSpec:
    """Return a scene with a joint closed."""
    state = scene.object(item.name).joint_state | {joint.name: opening_value(joint, 0.0)}
    return _replaced(scene, item.model_copy(update={"joint_state": state}))


def _replaced(scene: SceneSpec, item: SceneObject) -> SceneSpec:
    objects = [item if other.name == item.name else other for other in scene.objects]
    return scene.model_copy(update={"objects": tuple(objects)})


def _depths(scene: SceneSpec, name: str) -> dict[tuple[str, str], float]:
    depths = object_depths(scene, *start_state(scene))
    return {pair: depth for pair, depth in depths.items() if name in pair}


def _is_seen(scene: SceneSpec, closed: SceneSpec) -> bool:
    assert scene.camera is not None
    depths = [np.minimum(draw_scene(s, scene.camera, 640).depth, 1e3) for s in (scene, closed)]
    return int((np.abs(depths[0] - depths[1]) > SEEN_M).sum()) >= SEEN_PX


def initial_scene(truth: SceneSpec, number: int, *, programs: bool) -> SceneSpec:
    """Return the ground truth with errors; it is not fitted and composed as in a run.

    Args:
        truth: ground truth of a scene of the benchmark.
        number: seed of the noise.
        programs: if True, programs have errors, too.
    """
    rng = np.random.default_rng((number, 53))
    shapes = wrong_shapes(truth, number, NoiseLog()) if programs else {}
    objects = []
    for item in truth.objects:
        spec, state = shapes.get(item.name, item.spec), {}
        known = {joint.name: joint for joint in spec.joints}
        for name, value in item.joint_state.items():
            off, stretch = OPENING * rng.normal(), RANGE * rng.normal()
            if name in known and known[name].type in ("revolute", "prismatic"):
                share = opening_share(item.spec.joint(name), value)
                # A wrong program already has a wrong range.
                share = (share if programs else share * math.exp(stretch)) + off
                state[name] = opening_value(known[name], float(np.clip(share, 0.0, 1.0)))
        box = item.box2d
        if box is not None:
            sides = np.array(box.as_tuple()) + rng.normal(0, BOX_PX, 4)
            box = (
                None
                if min(sides[2:] - sides[:2]) < 1
                else Box2D(**dict(zip(("x0", "y0", "x1", "y1"), sides.tolist(), strict=True)))
            )
        objects.append(item.model_copy(update={"spec": spec, "joint_state": state, "box2d": box}))
    scene = truth.model_copy(update={"objects": tuple(objects)})
    assert truth.camera is not None
    unknowns = Unknowns.of(scene, truth.camera, joints=False)
    x = np.zeros(unknowns.size)
    x[:CAMERA] = rng.normal(0, CAMERA_SD)
    x[CAMERA:] = rng.normal(0, PLACE_SD, (len(unknowns.free), len(PLACE_SD))).ravel()
    return unknowns.scene_at(x)


def opening_rows(name: str, *, starts: int = 2, seed: int = 0) -> Iterator[OpeningRow]:
    """Yield a row for each opened joint of a scene and each initial scene.

    Args:
        name: name of the scene.
        starts: number of initial scenes for each opened joint. Initial scenes with odd numbers have
            errors of programs.
        seed: seed of the noise.
    """
    for item, joint, truth in opened_scenes(name):
        photo = photograph(truth)
        for start in range(starts):
            number = noise_number(f"{name}/{item.name}/{joint.name}", seed, start)
            initial = initial_scene(truth, number, programs=bool(start % 2))
            if joint.name not in initial.object(item.name).joint_state:
                continue
            stages, alignment = {"composed": initial}, None
            for stage, joints in (("without", False), ("aligned", True)):
                alignment = align(initial, photo, AlignOptions(joints=joints))
                stages[stage] = alignment.scene
            assert alignment is not None
            change = alignment.objects.get(item.name)
            opening = None if change is None else change.joints.get(joint.name)
            yield OpeningRow(
                scene=name,
                object=item.name,
                joint=joint.name,
                start=start,
                range=joint.upper - joint.lower,
                truth=item.joint_state[joint.name],
                value={
                    stage: s.object(item.name).joint_state.get(joint.name, 0.0)
                    for stage, s in stages.items()
                },
                deviation=None if opening is None else opening.deviation,
                errors={stage: layout_errors(s, truth) for stage, s in stages.items()},
            )


MEASURES: dict[str, Callable[[OpeningRow, str], float]] = {
    "opening_percent": lambda r, stage: 100 * r.error(stage),
    "position_mm": lambda r, stage: 1e3 * r.errors[stage]["xy_error_m"],
    "heading_deg": lambda r, stage: r.errors[stage]["yaw_error_deg"],
    "size_percent": lambda r, stage: 100 * r.errors[stage]["scale_error"],
}
"""Errors of a row at a stage."""


def opening_summary(rows: Sequence[OpeningRow]) -> dict[str, Any]:
    """Return the mean errors of joints that are unknowns of the alignment, by stage.

    Returns:
        "n" and "joints" are the numbers of rows and of their joints, "table" has a row for each
        stage, and "aligned_minus_without" the differences with intervals, clustered by scene.
    """
    known = [row for row in rows if row.deviation is not None]
    difference = lambda r, of: of(r, "aligned") - of(r, "without")
    return {
        "n": len(known),
        "joints": len({(row.scene, row.object, row.joint) for row in known}),
        "table": [
            {"stage": stage}
            | {name: float(np.mean([of(r, stage) for r in known])) for name, of in MEASURES.items()}
            for stage in STAGES
            if known
        ],
        "aligned_minus_without": {
            name: ratio_interval([(r.scene, difference(r, of), 1) for r in known])
            for name, of in MEASURES.items()
        },
    }
