"""Scene composition: scale objects to their parsed boxes and snap them onto their supports.

Paper Section 3.3, Step 4, and Appendix B. Programs have arbitrary units. The parsed 3D box
determines the absolute scale of each object, and the support determines the object's height.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..config import ComposeOptions
from ..errors import SpecError
from ..spec import (
    Box3D,
    ObjectSpec,
    Quat,
    SceneObject,
    SceneSpec,
    SceneTree,
    TreeNode,
    bounds,
    support_frame,
    world_poses,
)
from ..spec.opening import matching_joint
from ..spec.pose import IDENTITY, Pose, angle_between, from_yaw, pose, quat_mul, rotate, yaw_of
from ..spec.scale import BoxFit, fit_to_box
from .on_supports import against_walls, snap
from .resting_pose import is_stable_upright, on_level, resting_tilt, with_joint_friction
from .settle import has_same_footprint, position_inside, settle

NOTED_TILT_DEG = 2.0
"""Smallest change from the parsed tilt that a note reports [deg]."""
NOTED_SLOPE_TILT_DEG = 10.0
"""Smallest change from the parsed tilt that a note reports on a curved or sloped support [deg].
There, an image hardly constrains the tilt."""
NOTED_SHIFT_M = 0.03
"""Smallest horizontal shift that a note reports [m]."""


@dataclass(frozen=True)
class Composed:
    """A composed scene, with notes on its differences from the parse."""

    scene: SceneSpec
    scales: dict[str, float]
    """Isotropic scale factor of each object."""
    notes: tuple[str, ...]
    """Descriptions of the differences; each begins with the name of the object."""
    shortfalls: tuple[str, ...] = ()
    """Notes that state where composition could not follow the parse; `notes` contains them, too."""


def compose(
    tree: SceneTree,
    objects: Mapping[str, ObjectSpec],
    options: ComposeOptions | None = None,
    *,
    name: str = "scene",
) -> Composed:
    """Compose a scene from a parse and the built objects, parents before children.

    Args:
        tree: the parse.
        objects: built object of every node, by the node's name.
        options: clearance under snapped objects, and switches for settling and joint friction.
        name: name of the scene.

    Raises:
        SpecError: a node has no object.
    """
    _check_objects(tree, objects)
    options = options or ComposeOptions()
    notes, shortfalls = list[str](), list[str]()
    placed: dict[str, SceneObject] = {}
    scales: dict[str, float] = {}
    for node in tree.top_down():
        fit = fit_to_box(objects[node.name], node)
        shortfalls += _unmatched_notes(node, fit)
        spec, state = fit.scaled()
        scales[node.name] = fit.factor
        # Relative difference between each edge and the parsed edge after isotropic scaling.
        residual = tuple((fit.factor / fit.ratio - 1.0).tolist())
        placed[node.name] = _place(node, tree, placed, spec, state, residual, notes, shortfalls)
        if options.settle:
            placed[node.name] = _settle_tilted(node, tree, placed, notes, shortfalls)
            placed[node.name] = _move_inside(placed[node.name], placed, notes)
        if options.hold_joints:
            placed[node.name] = with_joint_friction(placed[node.name], notes)
    scene = SceneSpec(name=name, objects=tuple(placed.values()), camera=tree.camera)
    touching = against_walls(scene)
    notes += _wall_notes(scene, touching)
    scene = snap(touching)
    return Composed(scene, scales, (*shortfalls, *notes), tuple(shortfalls))


def as_parsed(tree: SceneTree, objects: Mapping[str, ObjectSpec]) -> SceneSpec:
    """Return the built objects, scaled to their parsed boxes, at their parsed places.

    Objects are on their supports, but contents of containers at their parsed height: a place that
    is a little off may be on a rim, and would raise them.

    Args:
        tree: the parse.
        objects: built object of every node, by the node's name.

    Raises:
        SpecError: a node has no object.
    """
    _check_objects(tree, objects)
    placed: dict[str, SceneObject] = {}
    for node in tree.top_down():
        fit = fit_to_box(objects[node.name], node)
        placed[node.name] = _place(node, tree, placed, *fit.scaled(), (0.0, 0.0, 0.0), [], [])
    scene = SceneSpec(name="parsed", objects=tuple(placed.values()), camera=tree.camera)
    snapped = snap(scene)
    items = (
        parsed if parsed.relation == "in" else item
        for parsed, item in zip(scene.objects, snapped.objects, strict=True)
    )
    return scene.model_copy(update={"objects": tuple(items)})


def moved_tree(tree: SceneTree, before: SceneSpec, after: SceneSpec) -> SceneTree:
    """Return a tree with the camera of a scene, and its boxes moved and scaled as the objects.

    Objects that the user placed stay, also if their support moved.

    Args:
        tree: the parse.
        before: its objects, see `as_parsed`.
        after: the same objects, moved, turned about the vertical and scaled.
    """
    old_poses, new_poses, nodes = world_poses(before), world_poses(after), []
    for node in tree.nodes:
        old, new, box = old_poses[node.name], new_poses[node.name], node.box3d
        sizes = [np.subtract(*bounds(s.object(node.name).spec)) for s in (after, before)]
        ratio = float(np.linalg.norm(sizes[0]) / np.linalg.norm(sizes[1]))
        turn = yaw_of(new.quat) - yaw_of(old.quat)
        offset = rotate(from_yaw(turn), ratio * np.subtract(box.position, old.pos))
        moved = Box3D(
            position=tuple((new.pos + offset).tolist()),
            size=tuple((ratio * np.array(box.size)).tolist()),
            yaw=math.remainder(box.yaw + turn, 2 * math.pi),
        )
        unmoved = node.cues.kept or (node.parent is None and np.allclose(old.pos, new.pos))
        nodes.append(node if unmoved else node.model_copy(update={"box3d": moved}))
    return tree.model_copy(update={"camera": after.camera, "nodes": tuple(nodes)})


def _check_objects(tree: SceneTree, objects: Mapping[str, ObjectSpec]) -> None:
    missing = [node.name for node in tree.nodes if node.name not in objects]
    if missing:
        raise SpecError(
            f"no object for node {', '.join(missing)}; the objects are {sorted(objects)}"
        )


def _unmatched_notes(node: TreeNode, fit: BoxFit) -> list[str]:
    """Return a note for every part that is open in the photo and that no joint matches."""
    names = ", ".join(joint.name for joint in fit.spec.joints) or "none"
    return [
        f"{node.name}: the parse shows {part.part} open by {part.opening:.0%}, but no "
        f"joint of the program matches this part (joints: {names}); composition left it closed"
        for part in fit.unmatched
        if part.opening > 0
    ]


def _place(
    node: TreeNode,
    tree: SceneTree,
    placed: dict[str, SceneObject],
    spec: ObjectSpec,
    state: dict[str, float],
    residual: tuple[float, float, float],
    notes: list[str],
    shortfalls: list[str],
) -> SceneObject:
    frame, link = pose(), node.parent_link
    if node.parent is not None:
        parent = placed[node.parent]
        if link is not None and link not in [part.name for part in parent.spec.parts]:
            joint = matching_joint(parent.spec, link, "prismatic")
            substitute = None if joint is None else joint.child
            shortfalls.append(
                f"{node.name}: {node.parent} has no part {link!r}; composition placed it on "
                f"{'the whole object' if substitute is None else substitute}"
            )
            link = substitute
        parent_box = _parsed_pose(tree.node(node.parent))
        origin = parent_box.then(_origin_in_box(parent.spec, parent.joint_state))
        frame = support_frame(parent, origin, link)
    box = _parsed_pose(node, tilted=False)
    local_pose = frame.inverse().then(box).then(_origin_in_box(spec, state))
    tilt, shift = node.base_tilt, np.zeros(3)
    # On other supports, unstable objects settle from their resting poses on level ground.
    if on_level(node, tree) or (node.relation == "on" and np.allclose(tilt, IDENTITY)):
        tilt, shift = _resting_tilt(node, spec, state, notes, shortfalls)
    local_pose = local_pose.then(pose(shift))
    fixed = node.fastened
    if fixed and node.parent is not None and not placed[node.parent].static:
        shortfalls.append(
            f"{node.name}: {node.parent} is free to move, so composition did not fix it there"
        )
        fixed = False
    elif fixed and not node.fixed_base and not node.environment:
        notes.append(f"{node.name}: composition fixed it to {node.parent}, because it is attached")
    elif node.relation == "attached" and not fixed:
        notes.append(f"{node.name}: composition left it free to move, held by {node.held_by}")
    _, depth = tree.camera.project(node.box3d.corners(node.base_tilt).mean(axis=0))
    return SceneObject(
        name=node.name,
        spec=spec,
        parent=node.parent,
        parent_link=link,
        relation=node.relation,
        leans_on=node.leans_on,
        environment=node.environment,
        fixed_base=fixed,
        xy=tuple(local_pose.pos[:2].tolist()),
        z=float(local_pose.pos[2]),
        yaw=yaw_of(local_pose.quat),
        base_tilt=tilt,
        joint_state=state,
        box2d=node.box2d,
        occluded=node.occluded,
        depth=float(depth),
        parsed_size=node.box3d.size,
        scale_residual=residual,
        cues=node.cues,
        known="pose" if node.cues.kept else "size" if len(set(node.cues.known_size)) == 3 else None,
    )


def _settle_tilted(
    node: TreeNode,
    tree: SceneTree,
    placed: dict[str, SceneObject],
    notes: list[str],
    shortfalls: list[str],
) -> SceneObject:
    """Return an object after settling in simulation, if it is tilted or cannot stay upright.

    The object settles on its parent: on a curved or sloped support, the resting pose depends on the
    support.
    """
    obj = placed[node.name]
    is_stable = np.allclose(obj.base_tilt, IDENTITY) and (
        node.relation != "on" or is_stable_upright(obj.spec, obj.joint_state)
    )
    settles = not (obj.static or on_level(node, tree) or is_stable)
    if node.parent is None or not settles or node.relation not in ("on", "in"):
        return obj
    settled = settle(placed[node.parent], obj, _neighbors(obj, placed))
    if settled is None:
        shortfalls.append(
            f"{node.name}: composition kept the parsed tilt, at which it does not rest on "
            f"{node.parent}"
        )
        return obj
    tilted = float(np.degrees(angle_between(obj.base_tilt, settled.base_tilt)))
    shift = float(np.hypot(*np.subtract(settled.xy, obj.xy)))
    if tilted > NOTED_SLOPE_TILT_DEG or shift > NOTED_SHIFT_M:
        notes.append(
            f"{node.name}: settling it {node.relation} {node.parent} tilted it by {tilted:.0f} deg "
            f"and moved it by {1e3 * shift:.0f} mm sideways and "
            f"{1e3 * (settled.z - obj.z):+.0f} mm in height"
        )
    return settled


def _move_inside(obj: SceneObject, placed: dict[str, SceneObject], notes: list[str]) -> SceneObject:
    """Move an upright object in a container, or a lid on one, so that it stands inside."""
    upright = np.allclose(obj.base_tilt, IDENTITY)
    if obj.parent is None or obj.static or not upright or obj.relation not in ("on", "in"):
        return obj
    parent = placed[obj.parent]
    if obj.relation == "on" and (parent.environment or not has_same_footprint(parent, obj)):
        return obj
    position = position_inside(parent, obj, _neighbors(obj, placed), if_raised=True)
    if position is None:
        return obj
    shift = float(np.hypot(*np.subtract(position, obj.xy)))
    notes.append(
        f"{obj.name}: composition moved it by {1e3 * shift:.0f} mm, to where it stands lower "
        f"{'in' if obj.relation == 'in' else 'on'} {obj.parent}"
    )
    return obj.model_copy(update={"xy": tuple(position.tolist())})


def _wall_notes(before: SceneSpec, after: SceneSpec) -> list[str]:
    """Return a note for every object that moved far to touch the wall to which it is attached."""
    pairs = zip(before.objects, after.objects, strict=True)
    shifts = [(new, float(np.hypot(*np.subtract(new.xy, old.xy)))) for old, new in pairs]
    return [
        f"{item.name}: composition moved it by {1e3 * shift:.0f} mm, to touch {item.parent}"
        for item, shift in shifts
        if shift > NOTED_SHIFT_M
    ]


def _neighbors(obj: SceneObject, placed: dict[str, SceneObject]) -> list[SceneObject]:
    """Return the other placed objects on or in the same parent."""
    location = obj.parent, obj.parent_link
    others = [other for name, other in placed.items() if name != obj.name]
    return [other for other in others if (other.parent, other.parent_link) == location]


def _resting_tilt(
    node: TreeNode,
    spec: ObjectSpec,
    state: dict[str, float],
    notes: list[str],
    shortfalls: list[str],
) -> tuple[Quat, NDArray]:
    """Return the tilt of a resting pose on level ground, and the shift of the object's origin [m].

    A stable upright object stays upright. A spoon with a round handle rolls onto its side.
    """
    parsed = node.base_tilt
    upright = np.allclose(parsed, IDENTITY)
    if node.fastened or node.environment or (upright and is_stable_upright(spec, state)):
        return parsed, np.zeros(3)
    tilt = resting_tilt(spec, state, parsed)
    if tilt is None:
        shortfalls.append(
            f"{node.name}: composition kept the parsed tilt, near which it has no resting pose"
        )
        return parsed, np.zeros(3)
    tilted = float(np.degrees(angle_between(parsed, tilt)))
    if upright and tilted <= NOTED_TILT_DEG:
        return parsed, np.zeros(3)
    if tilted > NOTED_TILT_DEG:
        notes.append(f"{node.name}: composition tilted it by {tilted:.1f} deg to its resting pose")
    parsed_center, center = (np.mean(bounds(spec, state, quat), axis=0) for quat in (parsed, tilt))
    return tilt, (parsed_center - center) * [1.0, 1.0, 0.0]


def _parsed_pose(node: TreeNode, *, tilted: bool = True) -> Pose:
    yaw = from_yaw(node.box3d.yaw)
    quat = quat_mul(yaw, node.base_tilt) if tilted else yaw
    return pose(node.box3d.position, quat)


def _origin_in_box(spec: ObjectSpec, state: dict[str, float]) -> Pose:
    """Return the object's origin relative to the bottom center of its box, with posed joints.

    The two points coincide if all joints are closed. An open drawer moves the center of the box,
    but not the origin.
    """
    low, high = bounds(spec, state)
    return pose([-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]])
