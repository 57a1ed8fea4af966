"""Read the mechanism of an MJCF file through MuJoCo's compiler.

MuJoCo resolves defaults, classes, includes and units; the compiled model is read at the pose in
which the object is drawn. Only what the model no longer holds is taken from the text.
"""

import os
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..spec import Box, Capsule, Cylinder, Ellipsoid, JointSpec, JointType, Sphere
from ..spec.base_shape import BaseShape
from .checked_xml import inside, read_xml
from .mechanism import (
    Link,
    LinkShape,
    Mechanism,
    Triangles,
    check_tree,
    triple,
    unchecked_joint,
    unchecked_mimic,
)

_G, _J = mujoco.mjtGeom, mujoco.mjtJoint
LOST = ("tendon", "actuator", "sensor", "contact", "keyframe", "deformable", "extension")
FILES = {"mesh": "meshdir", "hfield": "meshdir", "skin": "meshdir", "texture": "texturedir"}


def read_mjcf(path: Path) -> Mechanism:
    """Read an MJCF file with one object.

    Raises:
        SpecError: the file is broken or hostile, names a file that is not there or lies outside its
            folder, MuJoCo refuses it, or it holds several objects.
    """
    path = Path(path)
    notes: list[str] = []
    roots = _checked_roots(path, path, set())
    if roots[0].tag != "mujoco":
        raise SpecError(f"{path}: an MJCF file begins with <mujoco>, this with <{roots[0].tag}>")
    for tag in LOST:
        if any(root.find(tag) is not None for root in roots):
            notes.append(f"{tag} is not carried")
    model, stated, massless = _compiled(path, notes)
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    mujoco.mj_kinematics(model, data)
    top = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0]
    full = [b for b in top if _geoms_below(model, b)]
    if len(full) != 1:
        names = ", ".join(_name(model, b) for b in full) or "none"
        raise SpecError(f"{path}: an object is one body in the world, this file has {names}")
    if np.any(model.geom_bodyid == 0):
        notes.append("geoms of the world itself, such as a floor, are not carried")
    bodies = [full[0]]
    for b in range(full[0] + 1, model.nbody):
        if int(model.body_parentid[b]) in bodies:
            bodies.append(b)
    links = [_link(model, data, b, stated, massless, notes) for b in bodies]
    joints, inner = _joints(path, model, data, bodies, notes)
    links += inner
    check_tree(path, [link.name for link in links], [(j.name, j.parent, j.child) for j in joints])
    name = os.path.basename(roots[0].get("model") or path.stem)
    return Mechanism(name, {link.name: link for link in links}, joints, notes)


def _checked_roots(path: Path, main: Path, visited: set[Path]) -> list[ET.Element]:
    """Check a file and all that it includes; return their roots, the main one first."""
    if path.resolve() in visited:
        raise SpecError(f"{path} includes itself")
    visited.add(path.resolve())
    root = read_xml(path)
    roots = [root]
    for element in root.iter("include"):
        roots += _checked_roots(inside(main, element.get("file") or ""), main, visited)
    folders: dict[str, str] = {}
    for compiler in (c for r in roots for c in r.iter("compiler")):
        both = compiler.get("assetdir")
        if both is not None:
            folders |= {"meshdir": both, "texturedir": both}
        folders |= {k: v for k in ("meshdir", "texturedir") if (v := compiler.get(k)) is not None}
        if compiler.get("strippath") == "true":
            folders["strip"] = "true"
    for element in root.iter():
        if element.tag in ("model", "attach", "plugin"):
            raise SpecError(f"{path}: <{element.tag}> is not read; give one self-contained file")
        for key, value in element.attrib.items():
            if not key.startswith("file") or element.tag in ("include", "mujoco"):
                continue
            where = folders.get(FILES.get(element.tag, "meshdir"), "")
            named = os.path.basename(value) if "strip" in folders else value
            inside(main, named, where)
    return roots


def _compiled(
    path: Path, notes: list[str]
) -> tuple[mujoco.MjModel, dict[str, tuple[float, NDArray]], set[str]]:
    """Compile a file; one with impossible inertias is compiled with others.

    Returns:
        The model, the stated masses and moments by body where they were replaced, and the bodies
        whose only mass is the compiler's lower bound.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise SpecError(f"{path} is refused by MuJoCo: {_line(error)}") from None
    spec.compiler.discardvisual = False
    spec.compiler.fusestatic = False
    try:
        model = spec.compile()
        least = float(spec.compiler.boundmass)
        light = {b.name for b in spec.bodies if not b.explicitinertial}
        light &= {model.body(b).name for b in range(model.nbody) if model.body_mass[b] <= least}
        return model, {}, light
    except (ValueError, mujoco.FatalError) as error:
        if "inertia" not in str(error) and "mass" not in str(error):
            raise SpecError(f"{path} is refused by MuJoCo: {_line(error)}") from None
        why = _line(error)
    stated = {}
    for body in spec.bodies:
        if body.explicitinertial:
            stated[body.name] = (float(body.mass), np.array(body.inertia))
            body.mass, body.inertia = max(float(body.mass), 1e-6), np.full(3, 1e-6)
            body.fullinertia = np.full(6, np.nan)
    spec.compiler.balanceinertia, spec.compiler.boundmass = True, 1e-6
    spec.compiler.boundinertia = 1e-9
    try:
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise SpecError(f"{path} is refused by MuJoCo: {_line(error)}") from None
    notes.append(f"MuJoCo refuses it as it is: {why}")
    return model, stated, set()


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:240]


def _link(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    b: int,
    stated: dict[str, tuple[float, NDArray]],
    massless: set[str],
    notes: list[str],
) -> Link:
    link = Link(_name(model, b), origin=data.xpos[b].copy())
    for g in np.flatnonzero(model.geom_bodyid == b):
        shape = _shape(model, data, int(g), link.name, notes)
        if shape is not None:
            link.shapes.append(shape)
    visual = all(shape.role == "visual" for shape in link.shapes)
    if link.name in massless and visual and not model.body_jntnum[b]:
        link.visual_only = True
    elif model.body_mass[b] > 0:
        turn = data.ximat[b].reshape(3, 3)
        mass, moments = float(model.body_mass[b]), model.body_inertia[b]
        if link.name in stated:
            mass, moments = stated[link.name]
        link.mass, link.com = mass, data.xipos[b].copy()
        with np.errstate(invalid="ignore", over="ignore"):  # Refused later, by name.
            link.inertia = turn @ np.diag(moments) @ turn.T
    return link


def _shape(
    model: mujoco.MjModel, data: mujoco.MjData, g: int, link: str, notes: list[str]
) -> LinkShape | None:
    at = np.eye(4)
    at[:3, :3], at[:3, 3] = data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g]
    size, kind = [float(v) for v in model.geom_size[g]], int(model.geom_type[g])
    shape: BaseShape | Triangles
    if kind == _G.mjGEOM_BOX:
        shape = Box(size=(2 * size[0], 2 * size[1], 2 * size[2]))
    elif kind == _G.mjGEOM_SPHERE:
        shape = Sphere(radius=size[0])
    elif kind == _G.mjGEOM_CAPSULE:
        shape = Capsule(radius=size[0], length=2 * size[1])
    elif kind == _G.mjGEOM_CYLINDER:
        shape = Cylinder(radius=size[0], height=2 * size[1])
    elif kind == _G.mjGEOM_ELLIPSOID:
        shape = Ellipsoid(radii=(size[0], size[1], size[2]))
    elif kind == _G.mjGEOM_MESH:
        m = int(model.geom_dataid[g])
        v, f = int(model.mesh_vertadr[m]), int(model.mesh_faceadr[m])
        vertices = model.mesh_vert[v : v + model.mesh_vertnum[m]].astype(float)
        shape = (vertices, model.mesh_face[f : f + model.mesh_facenum[m]].astype(np.int64))
    else:
        notes.append(f"body {link}: a geom of type {_G(kind).name[7:].lower()} is not carried")
        return None
    collides = bool(model.geom_contype[g]) or bool(model.geom_conaffinity[g])
    material = int(model.geom_matid[g])
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[g]
    red, green, blue, alpha = (float(v) for v in rgba)
    return LinkShape(
        shape,
        at,
        "collision" if collides else "visual",
        (red, green, blue, alpha),
        float(model.geom_friction[g, 0]) if collides else 0.5,
        hull=collides,  # MuJoCo collides meshes as their hulls.
    )


def _joints(
    path: Path, model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int], notes: list[str]
) -> tuple[list[JointSpec], list[Link]]:
    """Return the joints of bodies, and links between several joints of one body."""
    ties = _ties(model, notes)
    joints: list[JointSpec] = []
    inner: list[Link] = []
    for b in bodies[1:]:
        parent, child = _name(model, int(model.body_parentid[b])), _name(model, b)
        own = range(
            int(model.body_jntadr[b]), int(model.body_jntadr[b]) + int(model.body_jntnum[b])
        )
        if not own:
            at = triple(data.xpos[b])
            joints.append(
                unchecked_joint(
                    name=f"{child}_fixed", type="fixed", parent=parent, child=child, pos=at
                )
            )
        for k, j in enumerate(own):
            last = k == len(own) - 1
            below = child if last else f"{child}_axis_{k}"
            if not last:
                inner.append(Link(below, origin=data.xpos[b].copy()))
            joints.append(_joint(path, model, data, j, parent, below, ties, notes))
            parent = below
    root = bodies[0]
    for j in range(
        int(model.body_jntadr[root]), int(model.body_jntadr[root]) + int(model.body_jntnum[root])
    ):
        if model.jnt_type[j] != _J.mjJNT_FREE:
            notes.append(f"joint {model.joint(j).name} moves the whole object and is not carried")
    return joints, inner


def _joint(
    path: Path,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    j: int,
    parent: str,
    child: str,
    ties: dict[int, Any],
    notes: list[str],
) -> JointSpec:
    name, kind = model.joint(j).name or f"{child}_joint", int(model.jnt_type[j])
    at, dof = triple(data.xanchor[j]), int(model.jnt_dofadr[j])
    limited = bool(model.jnt_limited[j])
    common: dict[str, Any] = {"name": name, "parent": parent, "child": child, "pos": at}
    losses: dict[str, Any] = {
        "damping": float(np.ravel(model.dof_damping[dof])[0]),
        "friction": float(model.dof_frictionloss[dof]),
        "stiffness": float(np.ravel(model.jnt_stiffness[j])[0]),
        "armature": float(model.dof_armature[dof]),
    }
    if kind == _J.mjJNT_BALL:
        if "ball" in get_args(JointType):
            upper = float(min(model.jnt_range[j, 1], np.pi)) if limited else 0.0
            return unchecked_joint(**common, **losses, type="ball", upper=upper)
        notes.append(f"joint {name} is a ball joint: carried as fixed")
        return unchecked_joint(**common, type="fixed")
    if kind == _J.mjJNT_FREE:
        raise SpecError(f"{path}: joint {name} is free within the object")
    slide = kind == _J.mjJNT_SLIDE
    drawn = float(model.qpos0[model.jnt_qposadr[j]])
    lower, upper = (float(v) - drawn for v in model.jnt_range[j])
    if slide and not limited:
        raise SpecError(f"{path}: joint {name} slides and states no limits")
    if limited and not lower < upper:
        raise SpecError(f"{path}: joint {name}: its range {lower:g} to {upper:g} is empty")
    if (
        losses["stiffness"] > 0
        and abs(float(model.qpos_spring[model.jnt_qposadr[j]]) - drawn) > 1e-9
    ):
        notes.append(f"joint {name}: its spring is at rest elsewhere, which is not carried")
    mimic = None
    if j in ties:
        leader, coefficients = ties[j]
        mimic = unchecked_mimic(leader, float(coefficients[1]), float(coefficients[0]))
    force = float(model.jnt_actfrcrange[j, 1]) if model.jnt_actfrclimited[j] else 0.0
    return unchecked_joint(
        **common,
        **losses,
        type="prismatic" if slide else "revolute" if limited else "continuous",
        axis=triple(data.xaxis[j]),
        lower=lower if limited else 0.0,
        upper=upper if limited else 0.0,
        effort=force if force > 0 else None,
        mimic=mimic,
    )


def _ties(model: mujoco.MjModel, notes: list[str]) -> dict[int, Any]:
    ties: dict[int, Any] = {}
    for e in range(model.neq):
        if model.eq_type[e] != mujoco.mjtEq.mjEQ_JOINT or model.eq_obj2id[e] < 0:
            notes.append("an equality that ties no two joints is not carried")
            continue
        if np.any(model.eq_data[e, 2:5]):
            notes.append("of a tie between joints only the linear part is carried")
        leader = model.joint(int(model.eq_obj2id[e])).name
        ties[int(model.eq_obj1id[e])] = (leader, model.eq_data[e])
    return ties


def _geoms_below(model: mujoco.MjModel, body: int) -> bool:
    return bool(np.any(model.body_rootid[model.geom_bodyid] == body))


def _name(model: mujoco.MjModel, body: int) -> str:
    return model.body(body).name or f"body_{body}"


__all__ = ["read_mjcf"]
