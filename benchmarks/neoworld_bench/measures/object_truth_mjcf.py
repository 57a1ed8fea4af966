"""Ground truth of an object from a published MJCF file: joints, and samples of the surface."""

from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from neoworld_mjx.errors import SpecError

from .object_truth import Front, ObjectTruth, truth_from
from .surface_measure import SAMPLES, sampled

if TYPE_CHECKING:
    import trimesh

SHOWN_GROUPS = (0, 1, 2)
"""Geom groups that MuJoCo's viewer shows by default; colliders are usually in group 3."""
_TYPES = {
    mujoco.mjtJoint.mjJNT_HINGE: "revolute",
    mujoco.mjtJoint.mjJNT_SLIDE: "prismatic",
    mujoco.mjtJoint.mjJNT_BALL: "ball",
}


def truth_of_mjcf(
    path: Path,
    *,
    front: Front = "+x",
    groups: tuple[int, ...] = SHOWN_GROUPS,
    samples: int = SAMPLES,
    seed: int = 0,
) -> tuple[ObjectTruth, NDArray]:
    """Read the joints and the surface of a model, with all joints at their reference positions.

    Free joints and joints that move nothing visible are omitted. A hinge without limits is
    continuous. Planes and height fields are not part of the object.

    Args:
        path: the MJCF file; meshes are read from the paths in the file.
        front: direction in which the object's front faces in the model's world frame, because MJCF
            does not store it.
        groups: geom groups that count as visible.
        samples: number of samples of the surface.
        seed: seed of the samples.

    Returns:
        The ground truth, and samples in the same frame [m], shape [samples, 3].

    Raises:
        SpecError: the file cannot be read, or no geom in it is visible.
    """
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise SpecError(f"{path}: MuJoCo cannot read it: {error}") from None
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    visuals = {
        geom: mesh
        for geom in range(model.ngeom)
        if int(model.geom_group[geom]) in groups and (mesh := _mesh(model, data, geom)) is not None
    }
    if not visuals:
        raise SpecError(f"{path}: no geom of the groups {groups} is visible")
    corners = np.vstack([mesh.bounds for mesh in visuals.values()])
    joints = []
    for joint in range(model.njnt):
        kind = _TYPES.get(mujoco.mjtJoint(model.jnt_type[joint]))
        body = int(model.jnt_bodyid[joint])
        moved_bounds = [m.bounds for geom, m in visuals.items() if _descends(model, geom, body)]
        if kind is None or not moved_bounds:
            continue
        limits = None
        if model.jnt_limited[joint] and kind != "ball":
            initial_position = float(model.qpos0[model.jnt_qposadr[joint]])
            limits = [float(v) - initial_position for v in model.jnt_range[joint]]
        if kind == "revolute" and limits is None:
            kind = "continuous"
        box = np.vstack(moved_bounds)
        joints.append(
            {
                "name": model.joint(joint).name or f"joint_{joint}",
                "type": kind,
                "axis": data.xaxis[joint].tolist(),
                "pivot": data.xanchor[joint].tolist(),
                "limits": limits,
                "parent": model.body(int(model.body_parentid[body])).name,
                "child": model.body(body).name,
                "moving_box": [box.min(axis=0).tolist(), box.max(axis=0).tolist()],
            }
        )
    description = {
        "name": Path(path).stem,
        "front": front,
        "box": [corners.min(axis=0).tolist(), corners.max(axis=0).tolist()],
        "joints": joints,
    }
    return truth_from(description, str(path)), sampled(list(visuals.values()), samples, seed)


def _descends(model: mujoco.MjModel, geom: int, body: int) -> bool:
    """Return True if a geom belongs to a body or to a descendant of the body."""
    ancestor = int(model.geom_bodyid[geom])
    while ancestor not in (body, 0):
        ancestor = int(model.body_parentid[ancestor])
    return ancestor == body


def _mesh(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> "trimesh.Trimesh | None":
    """Return a geom's surface in the world frame; None for planes and height fields."""
    import trimesh

    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.mesh(int(model.geom_dataid[geom]))
        v, f = int(mesh.vertadr[0]), int(mesh.faceadr[0])
        vertices = model.mesh_vert[v : v + int(mesh.vertnum[0])]
        faces = model.mesh_face[f : f + int(mesh.facenum[0])]
        shape = trimesh.Trimesh(vertices, faces, process=False)
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        shape = trimesh.creation.box(extents=2 * size)
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        shape = trimesh.creation.cylinder(radius=size[0], height=2 * size[1], sections=64)
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        shape = trimesh.creation.capsule(height=2 * size[1], radius=size[0])
    elif kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        shape = trimesh.creation.icosphere(subdivisions=4)
        round_ = kind == mujoco.mjtGeom.mjGEOM_SPHERE
        shape.apply_scale(np.full(3, size[0]) if round_ else size)
    else:
        return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    shape.apply_transform(pose)
    return shape
