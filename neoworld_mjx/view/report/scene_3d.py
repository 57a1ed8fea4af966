"""The part of a report that turns: a scene in WebGL with a slider for every joint, no network.

The script is our own and lies in the page; the page's policy lets that one script run and no other.
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
from numpy.typing import NDArray

from ...render.part_meshes import PartMesh, visible_meshes
from ...render.scene_images import visible_vertices
from ...spec import JointSpec, SceneObject, SceneSpec, world_poses
from ...spec.kinematics import joint_keys
from ...spec.pose import Pose, matrix
from ...spec.triangles import corner_normals
from .page import Html, missing, section

TITLE = "In three dimensions"
MAX_TRIANGLES = 400_000
"""Most triangles that a page carries; a scene with more is left out, with a note."""
FOVY = math.radians(40)
_STEPS, _NORMAL = 65535, 127


@cache
def script() -> str:
    """Return the script of the page."""
    return resources.files(__package__).joinpath("scene_3d.js").read_text("utf-8")


def script_hash() -> str:
    """Return the script's hash as a content policy names it."""
    return f"'sha256-{base64.b64encode(sha256(script().encode()).digest()).decode()}'"


def scene_3d(scene: SceneSpec) -> Html:
    """Return the section with the scene, its script and its data."""
    data = scene_data(scene)
    count = sum(m.pop("triangles") for o in data["objects"] for part in o["parts"] for m in part)
    if count > MAX_TRIANGLES:
        note = f"The scene has {count} triangles, over the {MAX_TRIANGLES} that a page may carry; "
        return section(TITLE, missing(note + "neoworld view shows it."))
    # In a script element only "<" could end it.
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    hint = "Drag to turn, wheel or pinch to zoom, shift or two fingers to move, double click: back."
    return section(
        TITLE,
        '<canvas id="scene-3d"></canvas>',
        f'<p class="dim">{hint}</p><div id="scene-3d-controls"></div>',
        f'<script type="application/json" id="scene-3d-data">{text}</script>',
        f"<script>{script()}</script>",
    )


def scene_data(scene: SceneSpec) -> dict[str, Any]:
    """Return a scene as the script reads it: meshes by part, joints, and where to look from."""
    poses = world_poses(scene)
    points = {
        obj.name: poses[obj.name].apply(visible_vertices(obj.spec, obj.joint_state))
        for obj in scene.objects
    }
    movable = [points[o.name] for o in scene.objects if not o.static] or list(points.values())
    camera = scene.camera
    eye = _eye(np.vstack(movable), None if camera is None else camera.position())
    return {
        "eye": eye,
        "objects": [
            _object_data(obj, poses[obj.name]) | {"eye": _eye(points[obj.name], None)}
            for obj in scene.objects
        ],
    }


def _eye(points: NDArray, stands: NDArray | None) -> dict[str, Any]:
    """Return a view of points [n, 3] m from a place, or from the right, above and before them."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2
    away = np.array([-0.75, -0.45, 0.5]) if stands is None else stands - middle
    away = away / max(float(np.linalg.norm(away)), 1e-9)
    radius = float(np.linalg.norm(high - low)) / 2
    return {
        "middle": middle.tolist(),
        "azimuth": math.atan2(away[1], away[0]),
        "elevation": math.asin(float(np.clip(away[2], -1, 1))),
        "distance": max(1.1 * radius / math.sin(FOVY / 2), 0.05),
        "fovy": FOVY,
    }


def _object_data(obj: SceneObject, at: Pose) -> dict[str, Any]:
    spec = obj.spec
    index = {part.name: k for k, part in enumerate(spec.parts)}
    number = {joint.name: k for k, joint in enumerate(spec.joints)}
    carriers = {joint.child: number[joint.name] for joint in spec.joints}
    return {
        "name": obj.name,
        "pose": {"r": matrix(at.quat).ravel().tolist(), "p": at.pos.tolist()},
        "parts": [[_mesh_data(m) for m in visible_meshes(spec, part)] for part in spec.parts],
        "order": [index[part.name] for part, _ in spec.ordered],
        "by": [carriers.get(part.name, -1) for part in spec.parts],
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
    places = np.zeros((len(vertices), 4), np.uint16)
    places[:, :3] = np.round((vertices - low) / span * _STEPS)
    normals = np.zeros((len(vertices), 4), np.int8)
    at_corners = corner_normals(vertices, faces).reshape(-1, 3)
    normals[faces.ravel(), :3] = np.round(np.nan_to_num(at_corners) * _NORMAL)
    return {
        "low": np.round(low, 6).tolist(),
        "span": np.round(span, 9).tolist(),
        "rgba": [round(v / 255, 4) for v in mesh.rgb] + [round(mesh.alpha, 3)],
        "places": _encoded(places),
        "normals": _encoded(normals),
        "faces": _encoded(faces.astype("<u4")),
        "triangles": len(faces),
    }


def _encoded(array: NDArray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
