"""Responses to the forty scenes: the exact parse, and the parse with measured errors.

Heights over the support are those of the ground truth: composition sets them anyway.
"""

import math
from collections.abc import Collection

import numpy as np

from neoworld_mjx.spec import (
    Box2D,
    Box3D,
    Camera,
    PartState,
    SceneObject,
    SceneSpec,
    SceneTree,
    TreeNode,
    bounds,
    world_poses,
)
from neoworld_mjx.spec.opening import opening_share

from .rendered_scenes import occluders

LABELS = {
    "table": "table",
    "box": "box",
    "tall": "carton",
    "can": "can",
    "lying": "can",
    "ball": "ball",
    "mug": "mug",
    "bin": "tray",
    "in": "block",
    "plate": "plate",
    "cup": "glass",
    "leaning": "board",
    "rest": "block",
}
"""Labels by the last word of an object's name; others have those of their programs."""
PIXELS_PX, PIXELS = 1.2, 0.005
"""Noise of a side of a 2D box: pixels, and a share of the box."""
FOOT_PX = 5.0
"""Noise of the pixel by which a response places an object."""
DEPTH, ASIDE = 0.025, 0.01
"""Noise of positions along and across the view, over the distance, for responses in space."""
LOG_SIZE, LOG_ASPECT, YAW = 0.03, 0.015, math.radians(2.0)
OUTLIERS, FACTOR = 0.1, 4.0
"""Share of objects whose errors are `FACTOR` times as large."""
PITCH, LOG_HEIGHT, LOG_FOCAL, ROLL = math.radians(1.0), 0.025, 0.03, math.radians(0.5)
UNNAMED = 0.15
"""Share of occluders that a response does not name."""


def exact_response(scene: SceneSpec) -> SceneTree:
    """Return the exact parse of a photographed scene."""
    camera = scene.camera
    assert camera is not None
    boxes, hidden_by = upright_boxes(scene), occluders(scene)
    nodes = []
    for item in scene.objects:
        assert item.box2d is not None
        words = [word for word in item.name.split("_") if not word.isdigit()]
        nodes.append(
            TreeNode(
                name=item.name,
                label=LABELS.get(words[-1]) or item.spec.label,
                parent=item.parent,
                parent_link=item.parent_link,
                relation=item.relation,
                environment=item.environment,
                furniture=item.environment and item.parent is not None,
                fixed_base=item.fixed_base,
                articulation=_openings(item),
                occluded=item.occluded and not item.environment,
                occluded_by=() if item.environment else hidden_by[item.name],
                box2d=item.box2d,
                box3d=boxes[item.name],
                base_tilt=item.base_tilt,
            )
        )
    return SceneTree(camera=camera, nodes=tuple(nodes))


def _openings(item: SceneObject) -> tuple[PartState, ...]:
    """Return how far each joint that is not at 0 is open; balls and followers are left out."""
    states = []
    for joint in item.spec.joints:
        value = item.joint_state.get(joint.name, 0.0)
        if value and joint.mimic is None and joint.type in ("revolute", "continuous", "prismatic"):
            opening = opening_share(joint, value)
            states.append(PartState(part=joint.child, type=joint.type, opening=opening))
    return tuple(states)


def upright_boxes(scene: SceneSpec) -> dict[str, Box3D]:
    """Return the 3D boxes, as a parse gives them, of a scene in which only leaves are tilted."""
    poses = world_poses(scene)
    yaws: dict[str | None, float] = {None: 0.0}
    boxes = {}
    for item in scene.objects:
        yaws[item.name] = yaws[item.parent] + item.yaw
        low, high = bounds(item.spec, item.joint_state)
        foot = poses[item.name].apply([*((low + high) / 2)[:2], low[2]])
        lowest, _ = bounds(item.spec, item.joint_state, item.base_tilt)
        boxes[item.name] = Box3D(
            position=(float(foot[0]), float(foot[1]), float(poses[item.name].pos[2] + lowest[2])),
            size=tuple((high - low).tolist()),
            yaw=math.remainder(yaws[item.name], 2 * math.pi),
        )
    return boxes


def noisy_response(truth: SceneTree, number: int) -> SceneTree:
    """Return an exact parse with the errors of a model.

    Responses of even numbers place objects by pixels through their own wrong camera; those of odd
    numbers have errors in space.
    """
    rng = np.random.default_rng((number, 43))
    right, camera = truth.camera, _disturbed_camera(truth.camera, rng)
    nodes = [
        node
        if node.environment
        else node.model_copy(
            update={
                "box3d": _disturbed_box(node, right, camera, rng, by_pixel=number % 2 == 0),
                "box2d": disturbed_box2d(node.box2d, right, rng),
                "occluded_by": tuple(o for o in node.occluded_by if rng.uniform() > UNNAMED),
            }
        )
        for node in truth.nodes
    ]
    return SceneTree(camera=camera, nodes=tuple(nodes))


def with_boxes_redrawn(
    response: SceneTree, truth: SceneTree, names: Collection[str], number: int
) -> SceneTree:
    """Return a response with the 3D boxes of some objects drawn again.

    Args:
        response: a noisy one.
        truth: the exact one.
        names: objects whose boxes are drawn again, with the same noise levels.
        number: that of the response's noise.
    """
    rng = np.random.default_rng((number, 48))
    nodes = [
        node.model_copy(
            update={
                "box3d": _disturbed_box(
                    truth.node(node.name),
                    truth.camera,
                    response.camera,
                    rng,
                    by_pixel=number % 2 == 0,
                )
            }
        )
        if node.name in names
        else node
        for node in response.nodes
    ]
    return response.model_copy(update={"nodes": tuple(nodes)})


def _disturbed_camera(camera: Camera, rng: np.random.Generator) -> Camera:
    pitch, height, focal, roll = rng.normal(size=4)
    focal = camera.focal * math.exp(LOG_FOCAL * focal)
    return camera.model_copy(
        update={
            "pitch": camera.pitch + PITCH * pitch,
            "height": camera.height * math.exp(LOG_HEIGHT * height),
            "fovy": 2 * math.atan(camera.height_px / 2 / focal),
            "roll": camera.roll + (ROLL * roll if camera.roll else 0.0),
        }
    )


def _disturbed_box(
    node: TreeNode, right: Camera, camera: Camera, rng: np.random.Generator, *, by_pixel: bool
) -> Box3D:
    factor = FACTOR if rng.uniform() < OUTLIERS else 1.0
    size, place = np.array(node.box3d.size), np.array(node.box3d.position)
    log_size = factor * (LOG_SIZE * rng.normal() + LOG_ASPECT * rng.normal(size=3))
    yaw = node.box3d.yaw + factor * YAW * rng.normal()
    pixel = rng.normal(0, FOOT_PX, 2) * factor
    reach = np.linalg.norm(place - right.position()) * rng.normal(size=2) * factor
    if by_pixel:
        ray = camera.rays(right.project(place)[0] + pixel)
        place[:2] = ray[:2] * (place[2] - camera.height) / min(ray[2], -0.05)
    else:
        out = place[:2] / np.linalg.norm(place[:2])
        place[:2] += DEPTH * reach[0] * out + ASIDE * reach[1] * np.array([-out[1], out[0]])
    return Box3D(
        position=tuple(place.tolist()), size=tuple((size * np.exp(log_size)).tolist()), yaw=yaw
    )


def disturbed_box2d(box: Box2D, camera: Camera, rng: np.random.Generator) -> Box2D:
    """Return a 2D box with the noise of a response; sides at the image border stay there."""
    size = np.array([camera.width, camera.height_px])
    frame = np.array([0, 0, *size])
    sides = np.array(box.as_tuple())
    length = np.tile(sides[2:] - sides[:2], 2)
    noisy = sides + rng.normal(size=4) * (PIXELS_PX + PIXELS * length)
    noisy = np.where(np.abs(sides - frame) < 1, frame, noisy)
    noisy = np.clip(noisy, 0, np.tile(size, 2))
    # Boxes have at least one pixel.
    narrow = np.maximum(1.0 - (noisy[2:] - noisy[:2]), 0.0) / 2
    noisy += np.concatenate([-narrow, narrow])
    return Box2D(**dict(zip(("x0", "y0", "x1", "y1"), noisy.tolist(), strict=True)))
