"""Interactive view of a scene in the report, with a slider for each joint, in WebGL and offline.

The page contains the script, and the content security policy of the page allows no other script.
"""

import base64
import json
import math
from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from importlib import resources
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ...render.scene_images import visible_vertices
from ...render.tiles import PartMesh, visible_meshes
from ...spec import JointSpec, SceneObject, SceneSpec, world_poses
from ...spec.kinematics import joint_keys
from ...spec.pose import Pose, matrix
from ...spec.triangles import corner_normals
from .page import elements

TITLE = "In three dimensions"
MAX_TRIANGLES = 400_000
"""Maximum number of triangles of a scene; for a larger scene, the page contains only a note."""
FOVY = math.radians(40)
_STEPS, _NORMAL = 65535, 127


@cache
def script() -> str:
    """Return the script of the interactive view."""
    return resources.files("neoworld_mjx.view.report").joinpath("scene_3d.js").read_text("utf-8")


def script_hash() -> str:
    """Return the hash of the script in the syntax of a content security policy."""
    return f"'sha256-{base64.b64encode(sha256(script().encode()).digest()).decode()}'"


def scene_3d(scene: SceneSpec, max_triangles: int = MAX_TRIANGLES) -> Markup:
    """Return the section with the scene, the script and its data."""
    data = scene_data(scene)
    count = sum(m.pop("triangles") for o in data["objects"] for part in o["parts"] for m in part)
    if count > max_triangles:
        note = (
            f"The scene has {count} triangles, over the limit of {max_triangles}; neoworld view "
            "shows it."
        )
        return elements.section(TITLE, elements.missing(note))
    # Escape "<", the only character that could end the script element.
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    hint = "Drag: turn. Wheel or pinch: zoom. Shift or two fingers: move. Double click: reset."
    return elements.section(TITLE, elements.scene_3d(hint, text, script()))


def scene_data(scene: SceneSpec) -> dict[str, Any]:
    """Return the data of a scene for the script: meshes by part, joints, and viewpoints."""
    poses = world_poses(scene)
    points = {
        obj.name: poses[obj.name].apply(visible_vertices(obj.spec, obj.joint_state))
        for obj in scene.objects
    }
    movable = [points[o.name] for o in scene.objects if not o.static] or list(points.values())
    camera = scene.camera
    eye = _viewpoint(np.vstack(movable), None if camera is None else camera.position())
    return {
        "eye": eye,
        "objects": [
            _object_data(obj, poses[obj.name]) | {"eye": _viewpoint(points[obj.name], None)}
            for obj in scene.objects
        ],
    }


def _viewpoint(points: NDArray, position: NDArray | None) -> dict[str, Any]:
    """Return a view of points [n, 3] from the direction of a position, both in the world frame [m].

    By default, look from above, from the front (-x) and from the right (-y).
    """
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2
    direction = np.array([-0.75, -0.45, 0.5]) if position is None else position - middle
    direction = direction / max(float(np.linalg.norm(direction)), 1e-9)
    radius = float(np.linalg.norm(high - low)) / 2
    return {
        "middle": middle.tolist(),
        "azimuth": math.atan2(direction[1], direction[0]),
        "elevation": math.asin(float(np.clip(direction[2], -1, 1))),
        "distance": max(1.1 * radius / math.sin(FOVY / 2), 0.05),
        "fovy": FOVY,
    }


def _object_data(obj: SceneObject, pose: Pose) -> dict[str, Any]:
    spec = obj.spec
    index = {part.name: k for k, part in enumerate(spec.parts)}
    number = {joint.name: k for k, joint in enumerate(spec.joints)}
    parent_joints = {joint.child: number[joint.name] for joint in spec.joints}
    return {
        "name": obj.name,
        "pose": {"r": matrix(pose.quat).ravel().tolist(), "p": pose.pos.tolist()},
        "parts": [[_mesh_data(m) for m in visible_meshes(spec, part)] for part in spec.parts],
        "order": [index[part.name] for part, _ in spec.ordered],
        "by": [parent_joints.get(part.name, -1) for part in spec.parts],
        "joints": [_joint_data(joint, obj.joint_state, index, number) for joint in spec.joints],
    }


def _joint_data(
    joint: JointSpec,
    state: Mapping[str, float],
    index: Mapping[str, int],
    number: Mapping[str, int],
) -> dict[str, Any]:
    free = joint.type == "continuous" or (joint.type == "ball" and joint.upper == 0)
    ball = joint.type == "ball"
    low, high = (-joint.upper, joint.upper) if ball else (joint.lower, joint.upper)
    mimic = joint.mimic
    return {
        "name": joint.name,
        "type": joint.type,
        "parent": index[joint.parent],
        "axis": list(joint.axis),
        "pos": list(joint.pos),
        "low": -math.pi if free else low,
        "high": math.pi if free else high,
        "values": [state.get(key, 0.0) for key in joint_keys(joint)],
        "mimic": None
        if mimic is None
        else {
            "joint": number[mimic.joint],
            "multiplier": mimic.multiplier,
            "offset": mimic.offset,
        },
    }


def _mesh_data(mesh: PartMesh) -> dict[str, Any]:
    vertices, faces = mesh.vertices.astype(float), mesh.faces
    low = vertices.min(axis=0)
    span = np.maximum(vertices.max(axis=0) - low, 1e-9)
    positions = np.zeros((len(vertices), 4), np.uint16)
    positions[:, :3] = np.round((vertices - low) / span * _STEPS)
    normals = np.zeros((len(vertices), 4), np.int8)
    normals_at_corners = corner_normals(vertices, faces).reshape(-1, 3)
    normals[faces.ravel(), :3] = np.round(np.nan_to_num(normals_at_corners) * _NORMAL)
    return {
        "low": np.round(low, 6).tolist(),
        "span": np.round(span, 9).tolist(),
        "rgba": [round(v / 255, 4) for v in mesh.rgb] + [round(mesh.alpha, 3)],
        "places": _base64(positions),
        "normals": _base64(normals),
        "faces": _base64(faces.astype("<u4")),
        "triangles": len(faces),
    }


def _base64(array: NDArray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
