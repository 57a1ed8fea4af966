"""Reads objects from MJCF, as MuJoCo compiles it, after the file and its includes are checked."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..io.names import unused
from ..physics.mjcf import START
from ..quantities import count
from ..spec import Box, Capsule, Cylinder, Ellipsoid, JointSpec, Mimic, Site, Sphere
from ..spec.pose import triple
from ..spec.primitives import BaseShape
from .compile_mjcf import check_files, compiled, element_names, unsupported
from .mechanism import (
    SLIDE_M,
    WORLD,
    Assembly,
    FileScene,
    Link,
    LinkShape,
    Mechanism,
    gravity_notes,
    transformed,
)
from .write_mjcf import COLOR_SUFFIX

_G, _J = mujoco.mjtGeom, mujoco.mjtJoint
_SHAPES: dict[int, Callable[[float, float, float], BaseShape]] = {
    _G.mjGEOM_BOX: lambda x, y, z: Box(size=(2 * x, 2 * y, 2 * z)),
    _G.mjGEOM_SPHERE: lambda x, y, z: Sphere(radius=x),
    _G.mjGEOM_CAPSULE: lambda x, y, z: Capsule(radius=x, length=2 * y),
    _G.mjGEOM_CYLINDER: lambda x, y, z: Cylinder(radius=x, height=2 * y),
    _G.mjGEOM_ELLIPSOID: lambda x, y, z: Ellipsoid(radii=(x, y, z)),
}
"""Function that returns a shape from the three numbers of geom_size, by type of geom."""
PLANE_M, PLANE_THICKNESS_M = 5.0, 0.1
"""Least half edge length, and thickness, of the box that replaces an infinite plane [m]."""


class _File(NamedTuple):
    """A compiled file, with its bodies at the reference position of all joints."""

    path: Path
    model: mujoco.MjModel
    data: mujoco.MjData
    bodies: list[str]
    """Unique name of each body; a name that the file does not state is derived."""
    joints: list[str]
    """Unique name of each joint."""
    mimics: dict[int, Mimic]
    """`Mimic` of each joint that follows another joint, by the index of the joint."""


def read_mjcf(path: Path) -> Mechanism:
    """Read an MJCF file with one object, without the geoms of the world body.

    Raises:
        SpecError: the file is broken or hostile, refers to a file that is missing or outside its
            folder, is refused by MuJoCo, or contains several objects.
    """
    scene = read_mjcf_scene(path)
    objects = scene.objects
    bodies = [assembly for assembly in objects if not assembly.world]
    if len(bodies) != 1:
        names = ", ".join(assembly.path for assembly in objects)
        raise SpecError(f"{path}: expected one child of the world body; the file has {names}")
    result = transformed(bodies[0].mechanism, bodies[0].frame)
    result.notes += gravity_notes(scene.gravity)
    result.notes += [f"{item.path} of the world is not imported" for item in objects if item.world]
    return result


def read_mjcf_scene(path: Path) -> FileScene:
    """Read the geoms of the world body, and each of its children, as objects.

    The frame of an object is that of the child, or that of the world if joints connect the child to
    the world. If the file has a keyframe "start", as exported scenes do, poses and joint positions
    are those of the keyframe.

    Raises:
        SpecError: the file is broken or hostile, refers to a file that is missing or outside its
            folder, or is refused by MuJoCo, or contains no geometry.
    """
    path = Path(path)
    title = check_files(path)
    model = compiled(path)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    file_notes: list[str] = unsupported(model)
    bodies, joints = element_names(model)
    file = _File(path, model, data, bodies, joints, _mimics(model, joints, file_notes))
    collides = _colliding(model)
    objects = [*_planes(file, collides, file_notes), *_world_geoms(file, collides, file_notes)]
    for top in np.flatnonzero(model.body_parentid[1:] == 0) + 1:
        tree = model.body_rootid[model.geom_bodyid] == top
        # A file without any collider shows objects whose colliders are derived.
        if not tree.any() or (collides.any() and not collides[tree].any()):
            mass = float(model.body_subtreemass[top])
            weight = f" ({mass:g} kg)" if mass else ""
            file_notes.append(f"body {bodies[top]}{weight} collides with nothing: not imported")
        else:
            objects.append(_object(file, int(top), collides))
    if not objects:
        raise SpecError(f"{path}: no body has geometry")
    if len(objects) == 1:
        lone = objects[0].mechanism
        lone.name = title or path.stem
        if lone.fixed and not model.njnt:
            lone.fixed = False
            lone.notes.append("no joint lets the object move in the file: here it is free")
    for assembly in objects:
        assembly.mechanism.file_notes = file_notes
    off = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    return FileScene(objects, gravity=triple(np.zeros(3) if off else model.opt.gravity))


def _colliding(model: mujoco.MjModel) -> NDArray:
    """Return whether each geom can touch another geom, or one with MuJoCo's defaults, [ngeom]."""
    types, affinities = ([1, *array] for array in (model.geom_contype, model.geom_conaffinity))
    masks = np.bitwise_and.outer(types, affinities)
    return np.any((masks | masks.T) != 0, axis=1)[1:]


def _planes(file: _File, collides: NDArray, notes: list[str]) -> list[Assembly]:
    """Return the colliding planes of the world body as fixed objects."""
    model, result = file.model, []
    for g in np.flatnonzero((model.geom_bodyid == 0) & (model.geom_type == _G.mjGEOM_PLANE)):
        level = file.data.geom_xmat[g][8] > 0.99
        name = model.geom(g).name or ("floor" if level else "plane")
        if collides[g]:
            link = Link(name, [_shape(file, int(g), True, notes)], static=True)
            result.append(
                Assembly(name, Mechanism(name, {name: link}, [], fixed=True), np.eye(4), world=True)
            )
        else:
            notes.append(f"geom {name} of the world body collides with nothing: not imported")
    return result


def _world_geoms(file: _File, collides: NDArray, notes: list[str]) -> list[Assembly]:
    """Return the geoms of the world body that are not planes as one fixed object, if any."""
    model = file.model
    world = (model.geom_bodyid == 0) & (model.geom_type != _G.mjGEOM_PLANE)
    geoms: list[int] = np.flatnonzero(world).tolist()
    link = _link(file, 0, geoms, collides, notes)
    if not any(shape.role == "collision" for shape in link.shapes):
        if link.shapes:
            what = count(len(link.shapes), "geom")
            notes.append(f"{what} of the world body that collide with nothing: not imported")
        return []
    name = (model.geom(geoms[0]).name if len(geoms) == 1 else "") or "world_geoms"
    link = replace(link, name=name, static=True)
    return [Assembly(name, Mechanism(name, {name: link}, [], fixed=True), np.eye(4), world=True)]


def _object(file: _File, top: int, collides: NDArray) -> Assembly:
    """Return a child of the world body with all its descendants."""
    model, notes = file.model, list[str]()
    bodies = np.flatnonzero(model.body_rootid == top).tolist()
    links = [
        _link(file, b, np.flatnonzero(model.geom_bodyid == b).tolist(), collides, notes)
        for b in bodies
    ]
    if not collides.any():
        links = [replace(link, visual_only=False) for link in links]
    joints, inner = _joints(file, bodies, notes)
    first = _body_joints(model, top)
    moves = len(first) > 0
    free = moves and bool(model.jnt_type[first[0]] == _J.mjJNT_FREE)
    if moves and not free:
        links.insert(0, Link(WORLD, static=True))
    links += inner
    sites = [
        Site.model_construct(
            name=model.site(k).name.removeprefix(f"{file.bodies[top]}-"),
            part=file.bodies[b],
            pos=triple(file.data.site_xpos[k]),
        )
        for k, b in enumerate(model.site_bodyid)
        if b in bodies and model.site(k).name
    ]
    if model.body_mocapid[top] >= 0:
        notes.append("a mocap body moves only as a program prescribes: here it is fixed")
    name = file.bodies[top]
    by_name = {link.name: link for link in links}
    mechanism = Mechanism(name, by_name, joints, sites, notes, fixed=not free)
    start, state = _start(file, bodies)
    if moves and not free:
        return Assembly(name, mechanism, np.eye(4), state=state)
    reference = _frame(file.data.xmat[top], file.data.xpos[top])
    local = transformed(mechanism, np.linalg.inv(reference))
    frame = _frame(start.xmat[top], start.xpos[top])
    return Assembly(name, local, frame, state=state)


def _frame(axes: NDArray, origin: NDArray) -> NDArray:
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = axes.reshape(3, 3), origin
    return frame


def _start(file: _File, bodies: Sequence[int]) -> tuple[mujoco.MjData, dict[str, float]]:
    """Return the data, and the positions of bodies' joints, in the keyframe "start", if any."""
    model, state = file.model, dict[str, float]()
    keys = [k for k in range(model.nkey) if model.key(k).name == START]
    if not keys:
        return file.data, state
    data = mujoco.MjData(model)
    data.qpos[:] = model.key_qpos[keys[0]]
    mujoco.mj_kinematics(model, data)
    for j in (j for b in bodies for j in _body_joints(model, b)):
        if model.jnt_type[j] == _J.mjJNT_FREE:
            continue
        name, address = file.joints[j], int(model.jnt_qposadr[j])
        if model.jnt_type[j] == _J.mjJNT_BALL:
            vector = np.zeros(3)
            mujoco.mju_quat2Vel(vector, data.qpos[address : address + 4], 1.0)
            # With all joints at zero, the axes of the body are those of the object.
            values = {f"{name}.{a}": float(v) for a, v in zip("xyz", vector, strict=True)}
        else:
            values = {name: float(data.qpos[address] - model.qpos0[address])}
        state.update({key: value for key, value in values.items() if value})
    return data, state


def _body_joints(model: mujoco.MjModel, body: int) -> range:
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body]))


def _link(
    file: _File, body: int, geoms: Iterable[int], collides: NDArray, notes: list[str]
) -> Link:
    """Return a body with its compiled mass and inertia."""
    model, data = file.model, file.data
    link = Link(file.bodies[body], static=int(model.body_weldid[body]) == 0)
    for g in geoms:
        kind = _G(model.geom_type[g])
        if kind in _SHAPES or kind in (_G.mjGEOM_MESH, _G.mjGEOM_PLANE):
            link.shapes.append(_shape(file, int(g), bool(collides[g]), notes))
        else:
            what = f"geom {model.geom(g).name or g} of type {kind.name[7:].lower()}"
            notes.append(f"body {link.name}: {what} is not imported")
    link.visual_only = all(shape.role == "visual" for shape in link.shapes)
    if model.body_mass[body] > 0:
        turn = data.ximat[body].reshape(3, 3)
        link.mass, link.com = float(model.body_mass[body]), data.xipos[body].copy()
        link.inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T
    return link


def _shape(file: _File, g: int, collides: bool, notes: list[str]) -> LinkShape:
    """Return a geom. An infinite plane becomes a box that reaches beyond all bodies."""
    model, data = file.model, file.data
    frame = _frame(data.geom_xmat[g], data.geom_xpos[g])
    size, kind = [float(v) for v in model.geom_size[g]], _G(model.geom_type[g])
    material = int(model.geom_matid[g])
    gloss = [model.mat_metallic[material], model.mat_roughness[material]] if material >= 0 else []
    metallic, roughness = (float(v) if v >= 0 else None for v in gloss or (-1, -1))
    result = LinkShape(
        Sphere(radius=1.0),
        frame,
        "collision" if collides else "visual",
        _geom_color(model, g, notes),
        float(model.geom_friction[g, 0]) if collides else 0.5,
        hull=collides,  # MuJoCo collides the convex hulls of meshes.
        metallic=metallic,
        roughness=roughness,
    )
    if kind in _SHAPES:
        return replace(result, shape=_SHAPES[kind](*size))
    if kind == _G.mjGEOM_PLANE:
        away = np.linalg.norm(data.geom_xpos - data.geom_xpos[g], axis=1) + model.geom_rbound
        half = max(PLANE_M, 2 * float(away.max()), *size[:2])
        frame[:3, 3] -= frame[:3, 2] * PLANE_THICKNESS_M / 2
        box = Box(size=(2 * half, 2 * half, PLANE_THICKNESS_M))
        label = f"plane {model.geom(g).name}".strip()
        edges = " x ".join(f"{v:g}" for v in box.size)
        notes.append(f"{label} is infinite: here it is a box of {edges} m")
        return replace(result, shape=box)
    m = int(model.geom_dataid[g])
    v, f = int(model.mesh_vertadr[m]), int(model.mesh_faceadr[m])
    vertices = model.mesh_vert[v : v + model.mesh_vertnum[m]].astype(float)
    faces = model.mesh_face[f : f + model.mesh_facenum[m]].astype(np.int64)
    return replace(result, shape=(vertices, faces))


DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0], np.float32)
"""Color of geoms that state none."""


def _geom_color(
    model: mujoco.MjModel, g: int, notes: list[str]
) -> tuple[float, float, float, float]:
    """Return the RGBA color of a geom: its own, unless it is MuJoCo's default, or its material's.

    If the geom is textured, the color is the plain color that the file states (`COLOR_SUFFIX`). If
    the file states none, it is the material's color multiplied by the texture's mean color.
    """
    material = int(model.geom_matid[g])
    rgba = model.geom_rgba[g].astype(float)
    if material >= 0 and np.array_equal(model.geom_rgba[g], DEFAULT_RGBA):
        rgba = model.mat_rgba[material].astype(float)
    texture = -1
    if material >= 0:
        texture = int(model.mat_texid[material][mujoco.mjtTextureRole.mjTEXROLE_RGB])
    if texture >= 0:
        name = model.material(material).name + COLOR_SUFFIX
        stated = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name)
        channels = int(model.tex_nchannel[texture])
        if stated >= 0 and model.numeric_size[stated] == 3:
            first = int(model.numeric_adr[stated])
            rgba[:3] = model.numeric_data[first : first + 3]
        elif channels >= 3:
            first = int(model.tex_adr[texture])
            count = int(model.tex_height[texture]) * int(model.tex_width[texture]) * channels
            pixels = model.tex_data[first : first + count].reshape(-1, channels)
            rgba[:3] *= pixels[:, :3].mean(axis=0) / 255
            label = model.texture(texture).name or texture
            notes.append(f"texture {label} is replaced by its mean color")
    red, green, blue, alpha = (float(v) for v in rgba)
    return red, green, blue, alpha


def _joints(
    file: _File, bodies: Sequence[int], notes: list[str]
) -> tuple[list[JointSpec], list[Link]]:
    """Return the joints of bodies, and the links that separate several joints of one body."""
    model, taken_joints, taken = file.model, set(file.joints), set(file.bodies)
    joints: list[JointSpec] = []
    inner: list[Link] = []
    for b in bodies:
        parent, child = file.bodies[int(model.body_parentid[b])], file.bodies[b]
        indices = _body_joints(model, b)
        if not indices and b != bodies[0]:
            name = unused(f"{child}_fixed", taken_joints)
            taken_joints.add(name)
            joints.append(
                JointSpec.model_construct(
                    name=name, type="fixed", pos=triple(file.data.xpos[b]),
                    parent=parent, child=child,
                )
            )  # fmt: skip
        for k, j in enumerate(indices):
            if model.jnt_type[j] == _J.mjJNT_FREE:
                continue
            below = child if k == len(indices) - 1 else unused(f"{child}_axis_{k}", taken)
            taken.add(below)
            if below != child:
                inner.append(Link(below))
            joints.append(_joint(file, j, parent, below, notes))
            parent = below
    return joints, inner


def _joint(file: _File, j: int, parent: str, child: str, notes: list[str]) -> JointSpec:
    model, name = file.model, file.joints[j]
    kind, dof = int(model.jnt_type[j]), int(model.jnt_dofadr[j])
    limited = bool(model.jnt_limited[j])
    common: dict[str, Any] = {
        "name": name,
        "parent": parent,
        "child": child,
        "pos": triple(file.data.xanchor[j]),
        "damping": float(np.ravel(model.dof_damping[dof])[0]),
        "friction": float(model.dof_frictionloss[dof]),
        "stiffness": float(np.ravel(model.jnt_stiffness[j])[0]),
        "armature": float(model.dof_armature[dof]),
    }
    if kind == _J.mjJNT_BALL:
        upper = float(min(model.jnt_range[j, 1], np.pi)) if limited else 0.0
        return JointSpec.model_construct(**common, type="ball", upper=upper)
    slide = kind == _J.mjJNT_SLIDE
    reference = float(model.qpos0[model.jnt_qposadr[j]])
    lower, upper = (float(v) - reference for v in model.jnt_range[j])
    if abs(reference) > 1e-9:
        notes.append(f"joint {name}: its reference position {reference:g} is 0 here")
    if slide and not limited:
        lower, upper = -SLIDE_M, SLIDE_M
        notes.append(f"joint {name} slides without limits: here from {lower:g} to {upper:g} m")
    if limited and not lower < upper:
        raise SpecError(f"{file.path}: joint {name}: its range {lower:g} to {upper:g} is empty")
    rest = float(model.qpos_spring[model.jnt_qposadr[j]]) - reference
    if common["stiffness"] > 0 and abs(rest) > 1e-9:
        notes.append(f"joint {name}: the rest position {rest:g} of its spring is not kept, it is 0")
    least, force = model.jnt_actfrcrange[j] if model.jnt_actfrclimited[j] else (0.0, 0.0)
    if force != -least:
        notes.append(f"joint {name}: the least actuator force {least:g} is not kept: -{force:g}")
    turning = "revolute" if limited else "continuous"
    return JointSpec.model_construct(
        **common,
        type="prismatic" if slide else turning,
        axis=triple(file.data.xaxis[j]),
        lower=lower if limited or slide else 0.0,
        upper=upper if limited or slide else 0.0,
        effort=float(force) if force > 0 else None,
        mimic=file.mimics.get(j),
    )


def _mimics(model: mujoco.MjModel, joints: Sequence[str], notes: list[str]) -> dict[int, Mimic]:
    """Return the `Mimic` of each joint that an active joint equality constrains, by index."""
    mimics: dict[int, Mimic] = {}
    for e in range(model.neq):
        kind = mujoco.mjtEq(model.eq_type[e]).name[5:].lower()
        ends = [
            mujoco.mj_id2name(model, int(model.eq_objtype[e]), int(k)) or "world"
            for k in (model.eq_obj1id[e], model.eq_obj2id[e])
            if k >= 0 and kind != "joint"
        ] or [joints[k] for k in (model.eq_obj1id[e], model.eq_obj2id[e]) if k >= 0]
        label = f"equality {model.eq(e).name} ({kind} of {' and '.join(ends)})".replace("  ", " ")
        if not model.eq_active0[e]:
            notes.append(f"{label} is inactive: not imported")
            continue
        if kind != "joint" or model.eq_obj2id[e] < 0:
            held = f", which holds it at {model.eq_data[e, 0]:g}," if kind == "joint" else ""
            notes.append(f"{label}{held} is not imported")
            continue
        follower, leader = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        if len(set(model.body_rootid[model.jnt_bodyid[[follower, leader]]])) > 1:
            notes.append(f"{label}, which are joints of two objects, is not imported")
            continue
        offset, multiplier, *higher = (float(v) for v in model.eq_data[e, :5])
        if any(higher):
            values = " ".join(f"{v:g}" for v in higher)
            notes.append(f"{label}: the coefficients {values} of higher order are not kept")
        mimics[follower] = Mimic.model_construct(
            joint=joints[leader], multiplier=multiplier, offset=offset
        )
    return mimics
