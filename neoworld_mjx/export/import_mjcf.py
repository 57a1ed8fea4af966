"""MJCF from elsewhere to an ObjectSpec, by what MuJoCo compiles it to.

MuJoCo resolves defaults, classes, includes and units; read is the compiled model, at the pose in which
the object is drawn. Only what MuJoCo leaves no way back from is taken from the text.
"""

import os
from pathlib import Path
from typing import Any, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..spec import Box, Capsule, Cylinder, Ellipsoid, JointSpec, JointType, Sphere
from .guarded_xml import inside, read_xml
from .imported import Imported, Link, Solid, assemble, check_tree, follow, foreign
from .mechanism import triple

_G, _J = mujoco.mjtGeom, mujoco.mjtJoint
LOST = ("tendon", "actuator", "sensor", "contact", "keyframe", "deformable", "extension")
FILES = {"mesh": "meshdir", "hfield": "meshdir", "skin": "meshdir", "texture": "texturedir"}


def import_mjcf(path: Path) -> Imported:
    """Read an MJCF file with one object.

    Raises:
        SpecError: the file is broken or hostile, names a file that is not there or lies outside its
            folder, MuJoCo refuses it, or it holds several objects.
    """
    path = Path(path)
    notes: list[str] = []
    found = _guarded(path, path, set())
    if found[0].tag != "mujoco":
        raise SpecError(f"{path}: an MJCF file begins with <mujoco>, this with <{found[0].tag}>")
    for tag in LOST:
        if any(root.find(tag) is not None for root in found):
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
    joints, beads = _joints(path, model, data, bodies, notes)
    links += beads
    check_tree(path, [link.name for link in links], [(j.name, j.parent, j.child) for j in joints])
    name = os.path.basename(_model_name(found[0]) or path.stem)
    return assemble(name, links, joints, notes)


def _guarded(path: Path, main: Path, seen: set[Path]) -> list[Any]:
    """Look through a file and all that it includes; return their roots, the main one first."""
    if path.resolve() in seen:
        raise SpecError(f"{path} includes itself")
    seen.add(path.resolve())
    root = read_xml(path)
    roots = [root]
    for element in root.iter("include"):
        roots += _guarded(inside(main, element.get("file") or ""), main, seen)
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


def _model_name(root: Any) -> str:
    return root.get("model") or ""


def _compiled(
    path: Path, notes: list[str]
) -> tuple[mujoco.MjModel, dict[str, tuple[float, NDArray]], set[str]]:
    """Compile a file; where its inertias are impossible, with others, and return those stated.

    Returns:
        The model, masses and moments by body, and the bodies that have no mass but what the compiler
        gives every body at least.
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
    link = Link(_name(model, b))
    for g in np.flatnonzero(model.geom_bodyid == b):
        solid = _solid(model, data, int(g), link.name, notes)
        if solid is not None:
            link.solids.append(solid)
    seen = all(solid.role == "visual" for solid in link.solids)
    if link.name in massless and seen and not model.body_jntnum[b]:
        link.decoration = True
    elif model.body_mass[b] > 0:
        turn = data.ximat[b].reshape(3, 3)
        mass, moments = float(model.body_mass[b]), model.body_inertia[b]
        if link.name in stated:
            mass, moments = stated[link.name]
        link.mass, link.com = mass, data.xipos[b].copy()
        link.inertia = turn @ np.diag(moments) @ turn.T
    return link


def _solid(
    model: mujoco.MjModel, data: mujoco.MjData, g: int, link: str, notes: list[str]
) -> Solid | None:
    at = np.eye(4)
    at[:3, :3], at[:3, 3] = data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g]
    size, kind = [float(v) for v in model.geom_size[g]], int(model.geom_type[g])
    shape: Any
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
    solid = bool(model.geom_contype[g]) or bool(model.geom_conaffinity[g])
    r, g_, b, a = (float(v) for v in _rgba(model, g))
    return Solid(
        shape,
        at,
        "collision" if solid else "visual",
        (r, g_, b, a),
        float(model.geom_friction[g, 0]) if solid else 0.5,
        hull=solid,  # MuJoCo collides meshes as their hulls.
    )


def _rgba(model: mujoco.MjModel, g: int) -> NDArray:
    m = int(model.geom_matid[g])
    return model.mat_rgba[m] if m >= 0 else model.geom_rgba[g]


def _joints(
    path: Path, model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int], notes: list[str]
) -> tuple[list[JointSpec], list[Link]]:
    """Return the joints of bodies, and beads between several joints of one body."""
    ties = _ties(model, notes)
    joints: list[JointSpec] = []
    beads: list[Link] = []
    for b in bodies[1:]:
        parent, child = _name(model, int(model.body_parentid[b])), _name(model, b)
        own = range(
            int(model.body_jntadr[b]), int(model.body_jntadr[b]) + int(model.body_jntnum[b])
        )
        if not own:
            at = triple(data.xpos[b])
            joints.append(
                foreign(name=f"{child}_fixed", type="fixed", parent=parent, child=child, pos=at)
            )
        for k, j in enumerate(own):
            last = k == len(own) - 1
            below = child if last else f"{child}_bead_{k}"
            if not last:
                beads.append(Link(below))
            joints.append(_joint(path, model, data, j, parent, below, ties, notes))
            parent = below
    root = bodies[0]
    for j in range(
        int(model.body_jntadr[root]), int(model.body_jntadr[root]) + int(model.body_jntnum[root])
    ):
        if model.jnt_type[j] != _J.mjJNT_FREE:
            notes.append(f"joint {model.joint(j).name} moves the whole object and is not carried")
    return joints, beads


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
            return foreign(**common, **losses, type="ball", upper=upper)
        notes.append(f"joint {name} is a ball joint: carried as fixed")
        return foreign(**common, type="fixed")
    if kind == _J.mjJNT_FREE:
        raise SpecError(f"{path}: joint {name} is free within the object")
    slide = kind == _J.mjJNT_SLIDE
    drawn = float(model.qpos0[model.jnt_qposadr[j]])
    lower, upper = (float(v) - drawn for v in model.jnt_range[j])
    if slide and not limited:
        raise SpecError(f"{path}: joint {name} slides and states no limits")
    if limited and not lower < upper:
        raise SpecError(f"{path}: joint {name}: its range {lower:g} to {upper:g} is none")
    if (
        losses["stiffness"] > 0
        and abs(float(model.qpos_spring[model.jnt_qposadr[j]]) - drawn) > 1e-9
    ):
        notes.append(f"joint {name}: its spring is at rest elsewhere, which is not carried")
    mimic = None
    if j in ties:
        leader, coefficients = ties[j]
        mimic = follow(leader, float(coefficients[1]), float(coefficients[0]))
    force = float(model.jnt_actfrcrange[j, 1]) if model.jnt_actfrclimited[j] else 0.0
    return foreign(
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


__all__ = ["import_mjcf"]
