"""Reads objects from MJCF, which MuJoCo compiles after the file and its includes are checked."""

import itertools
import os
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ..errors import SpecError
from ..physics.mjcf import START
from ..spec import Box, Capsule, Cylinder, Ellipsoid, JointSpec, Mimic, Site, Sphere
from ..spec.pose import triple
from ..spec.primitives import BaseShape
from .load_mesh import inside, inside_any, read_xml
from .mechanism import (
    Assembly,
    Link,
    LinkShape,
    Mechanism,
    Triangles,
    check_tree,
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
_FOLDERS = {"texture": ("assetdir", "texturedir")}
"""Attributes of <compiler> that name the folder of an element's files, by tag of the element."""
_OTHER_FOLDERS = ("assetdir", "meshdir")
"""Attributes of <compiler> that name the folder of the files of all other elements."""
NOT_IMPORTED = ("tendon", "actuator", "sensor", "contact", "keyframe", "deformable", "extension")
"""Sections that are not imported, except for the keyframe "start"."""


def read_mjcf(path: Path) -> Mechanism:
    """Read an MJCF file with one object.

    Raises:
        SpecError: the file is broken or hostile, refers to a file that is missing or outside its
            folder, is refused by MuJoCo, or contains several objects.
    """
    assemblies = read_mjcf_scene(path)
    if len(assemblies) != 1:
        names = ", ".join(assembly.path for assembly in assemblies)
        raise SpecError(f"{path}: expected one child of the world body; the file has {names}")
    return transformed(assemblies[0].mechanism, assemblies[0].frame)


def read_mjcf_scene(path: Path) -> list[Assembly]:
    """Read each child of the world body of an MJCF file as an object, in the frame of the child.

    If the file has a keyframe "start", as exported scenes do, poses and joint positions are those
    of the keyframe. Geoms of the world body, such as a floor, are skipped.

    Raises:
        SpecError: the file is broken or hostile, refers to a file that is missing or outside its
            folder, or is refused by MuJoCo, or no body has geometry.
    """
    path = Path(path)
    file_notes: list[str] = []
    roots = _checked_roots(path)
    if roots[0].tag != "mujoco":
        raise SpecError(f"{path}: the root element of MJCF is <mujoco>, not <{roots[0].tag}>")
    file_notes += [
        f"{tag} is not imported"
        for tag in NOT_IMPORTED
        if any(r.find(tag) is not None for r in roots)
    ]
    model, massless = _compiled(path)
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    mujoco.mj_kinematics(model, data)
    title = os.path.basename(roots[0].get("model") or path.stem)
    tops = [
        b for b in range(1, model.nbody) if model.body_parentid[b] == 0 and _geoms_below(model, b)
    ]
    if np.any(model.geom_bodyid == 0):
        file_notes.append("geoms of the world body, such as a floor, are not imported")
    mimics = _mimics(model, file_notes)
    result = []
    for top in tops:
        name = title if len(tops) == 1 else _name(model, top)
        in_world = _mechanism(path, model, data, top, name, massless, mimics)
        in_world.file_notes = file_notes
        frame = np.eye(4)
        frame[:3, :3], frame[:3, 3] = data.xmat[top].reshape(3, 3), data.xpos[top]
        fixed = not any(model.jnt_type[j] == _J.mjJNT_FREE for j in _body_joints(model, top))
        local = transformed(in_world, np.linalg.inv(frame))
        assembly = Assembly(_name(model, top), local, frame, fixed)
        result.append(_without_prefix(_with_start_state(model, top, assembly)))
    if not result:
        raise SpecError(f"{path}: the world body has no child with geometry")
    return result


def _checked_roots(path: Path) -> list[ET.Element]:
    """Check an MJCF file and all files that it includes, and return their root elements.

    The first element is the root of `path`.

    Raises:
        SpecError: a file is broken or hostile, refers to a file that is missing or outside the
            folder of `path`, or includes itself.
    """
    roots = _included(path, path, set())
    elements = [element for root in roots for element in root.iter()]
    # MuJoCo decides which of several <compiler> elements applies, so all paths are checked.
    compilers = [element for element in elements if element.tag == "compiler"]
    stripped = any(compiler.get("strippath") == "true" for compiler in compilers)
    for element in elements:
        if element.tag in ("model", "attach", "plugin"):
            raise SpecError(
                f"{path}: <{element.tag}> is not supported; use one self-contained file"
            )
        if element.tag in ("include", "mujoco"):
            continue
        keys = _FOLDERS.get(element.tag, _OTHER_FOLDERS)
        folders = {folder for c in compilers for key in keys if (folder := c.get(key)) is not None}
        for key, value in element.attrib.items():
            if key.startswith("file"):
                names = {value, os.path.basename(value)} if stripped else {value}
                places = itertools.product(folders or {""}, names)
                inside_any(path, [os.path.join(*place) for place in places], value)
    return roots


def _included(path: Path, main: Path, visited: set[Path]) -> list[ET.Element]:
    if path.resolve() in visited:
        raise SpecError(f"{path} includes itself")
    visited.add(path.resolve())
    root = read_xml(path)
    roots = [root]
    for element in root.iter("include"):
        roots += _included(inside(main, element.get("file") or ""), main, visited)
    return roots


def _compiled(path: Path) -> tuple[mujoco.MjModel, set[str]]:
    """Return a compiled MJCF file, and the names of the bodies without a mass.

    The mass of a body without a mass is the lower bound that the compiler sets.

    Raises:
        SpecError: MuJoCo refuses the file.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compiler.discardvisual = False
        spec.compiler.fusestatic = False
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())[:240]
        raise SpecError(f"{path} is refused by MuJoCo: {reason}") from None
    bound = float(spec.compiler.boundmass)
    light = {model.body(b).name for b in range(model.nbody) if model.body_mass[b] <= bound}
    return model, {b.name for b in spec.bodies if not b.explicitinertial} & light


def _mechanism(
    path: Path,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    top: int,
    title: str,
    massless: set[str],
    mimics: dict[int, Mimic],
) -> Mechanism:
    """Return the mechanism of a body and its descendants, in the world frame."""
    notes: list[str] = []
    bodies = [top]
    for b in range(top + 1, model.nbody):
        if int(model.body_parentid[b]) in bodies:
            bodies.append(b)
    links = [_link(model, data, b, massless, notes) for b in bodies]
    joints, inner = _joints(path, model, data, bodies, mimics, notes)
    links += inner
    check_tree(path, [link.name for link in links], [(j.name, j.parent, j.child) for j in joints])
    sites = [
        Site.model_construct(
            name=model.site(k).name, part=_name(model, b), pos=triple(data.site_xpos[k])
        )
        for k, b in enumerate(int(b) for b in model.site_bodyid)
        if b in bodies and model.site(k).name
    ]
    return Mechanism(title, {link.name: link for link in links}, joints, sites, notes)


def _without_prefix(assembly: Assembly) -> Assembly:
    """Remove the prefix "<object>-" from all names of an object if all of them have it."""
    mechanism = assembly.mechanism
    root, prefix = mechanism.root, f"{mechanism.root}-"
    inner = [name for name in mechanism.links if name != root]
    names = [*inner, *(j.name for j in mechanism.joints), *(s.name for s in mechanism.sites)]

    def short(name: str) -> str:
        return name.removeprefix(prefix)

    if not all(name.startswith(prefix) for name in names) or root in map(short, inner):
        return assembly
    links = {short(name): replace(link, name=short(name)) for name, link in mechanism.links.items()}
    joints = []
    for joint in mechanism.joints:
        update = {key: short(getattr(joint, key)) for key in ("name", "parent", "child")}
        mimic = joint.mimic
        mimic = mimic and mimic.model_copy(update={"joint": short(mimic.joint)})
        joints.append(joint.model_copy(update={**update, "mimic": mimic}))
    sites = [
        site.model_copy(update={"name": short(site.name), "part": short(site.part)})
        for site in mechanism.sites
    ]
    state = {short(key): value for key, value in assembly.state.items()}
    renamed = replace(mechanism, links=links, joints=joints, sites=sites)
    return replace(assembly, mechanism=renamed, state=state)


def _body_joints(model: mujoco.MjModel, body: int) -> range:
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body]))


def _with_start_state(model: mujoco.MjModel, top: int, assembly: Assembly) -> Assembly:
    """Set the pose and joint positions of an object to those of the keyframe "start", if any."""
    keys = [k for k in range(model.nkey) if model.key(k).name == START]
    if not keys:
        return assembly
    qpos = model.key_qpos[keys[0]]
    for joint in assembly.mechanism.joints:
        j = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint.name)
        if j < 0 or joint.type == "fixed":
            continue
        address = int(model.jnt_qposadr[j])
        if joint.type == "ball":
            vector = np.zeros(3)
            mujoco.mju_quat2Vel(vector, qpos[address : address + 4], 1.0)
            # With all joints at zero, the axes of the body are those of the object.
            values = {f"{joint.name}.{a}": float(v) for a, v in zip("xyz", vector, strict=True)}
        else:
            values = {joint.name: float(qpos[address] - model.qpos0[address])}
        assembly.state.update({name: value for name, value in values.items() if value})
    for j in _body_joints(model, top):
        if model.jnt_type[j] == _J.mjJNT_FREE:
            address = int(model.jnt_qposadr[j])
            assembly.frame[:3, 3] = qpos[address : address + 3]
            rotation = np.zeros(9)
            mujoco.mju_quat2Mat(rotation, qpos[address + 3 : address + 7])
            assembly.frame[:3, :3] = rotation.reshape(3, 3)
    return assembly


def _link(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    b: int,
    massless: set[str],
    notes: list[str],
) -> Link:
    link = Link(_name(model, b))
    for g in np.flatnonzero(model.geom_bodyid == b):
        shape = _shape(model, data, int(g), link.name, notes)
        if shape is not None:
            link.shapes.append(shape)
    visual = all(shape.role == "visual" for shape in link.shapes)
    if link.name in massless and visual and not model.body_jntnum[b]:
        link.visual_only = True
    elif model.body_mass[b] > 0:
        turn = data.ximat[b].reshape(3, 3)
        link.mass, link.com = float(model.body_mass[b]), data.xipos[b].copy()
        link.inertia = turn @ np.diag(model.body_inertia[b]) @ turn.T
    return link


def _shape(
    model: mujoco.MjModel, data: mujoco.MjData, g: int, link: str, notes: list[str]
) -> LinkShape | None:
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g]
    size, kind = [float(v) for v in model.geom_size[g]], int(model.geom_type[g])
    shape: BaseShape | Triangles
    if kind in _SHAPES:
        shape = _SHAPES[kind](*size)
    elif kind == _G.mjGEOM_MESH:
        m = int(model.geom_dataid[g])
        v, f = int(model.mesh_vertadr[m]), int(model.mesh_faceadr[m])
        vertices = model.mesh_vert[v : v + model.mesh_vertnum[m]].astype(float)
        shape = (vertices, model.mesh_face[f : f + model.mesh_facenum[m]].astype(np.int64))
    else:
        notes.append(f"body {link}: a geom of type {_G(kind).name[7:].lower()} is not imported")
        return None
    collides = bool(model.geom_contype[g]) or bool(model.geom_conaffinity[g])
    material = int(model.geom_matid[g])
    red, green, blue, alpha = _geom_color(model, g)
    gloss = [model.mat_metallic[material], model.mat_roughness[material]] if material >= 0 else []
    metallic, roughness = (float(v) if v >= 0 else None for v in gloss or (-1, -1))
    return LinkShape(
        shape,
        frame,
        "collision" if collides else "visual",
        (red, green, blue, alpha),
        float(model.geom_friction[g, 0]) if collides else 0.5,
        hull=collides,  # MuJoCo collides the convex hulls of meshes.
        metallic=metallic,
        roughness=roughness,
    )


def _geom_color(model: mujoco.MjModel, g: int) -> tuple[float, float, float, float]:
    """Return the RGBA color of a geom.

    If the geom is textured, the color is the plain color that the file states (`COLOR_SUFFIX`). If
    the file states none, it is the material's color multiplied by the texture's mean color.
    """
    material = int(model.geom_matid[g])
    if material < 0:
        red, green, blue, alpha = (float(v) for v in model.geom_rgba[g])
        return red, green, blue, alpha
    rgba = model.mat_rgba[material].astype(float)
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
    red, green, blue, alpha = (float(v) for v in rgba)
    return red, green, blue, alpha


def _joints(
    path: Path,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    bodies: list[int],
    mimics: dict[int, Mimic],
    notes: list[str],
) -> tuple[list[JointSpec], list[Link]]:
    """Return the joints of bodies, and the links that separate several joints of one body."""
    joints: list[JointSpec] = []
    inner: list[Link] = []
    for b in bodies[1:]:
        parent, child = _name(model, int(model.body_parentid[b])), _name(model, b)
        indices = _body_joints(model, b)
        if not indices:
            fixed = {"name": f"{child}_fixed", "type": "fixed", "pos": triple(data.xpos[b])}
            joints.append(JointSpec.model_construct(**fixed, parent=parent, child=child))
        for k, j in enumerate(indices):
            last = k == len(indices) - 1
            below = child if last else f"{child}_axis_{k}"
            if not last:
                inner.append(Link(below))
            joints.append(_joint(path, model, data, j, parent, below, mimics, notes))
            parent = below
    root = bodies[0]
    for j in _body_joints(model, root):
        if model.jnt_type[j] != _J.mjJNT_FREE:
            notes.append(f"joint {model.joint(j).name} moves the whole object and is not imported")
    return joints, inner


def _joint(
    path: Path,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    j: int,
    parent: str,
    child: str,
    mimics: dict[int, Mimic],
    notes: list[str],
) -> JointSpec:
    name, kind = model.joint(j).name or f"{child}_joint", int(model.jnt_type[j])
    anchor, dof = triple(data.xanchor[j]), int(model.jnt_dofadr[j])
    limited = bool(model.jnt_limited[j])
    common: dict[str, Any] = {"name": name, "parent": parent, "child": child, "pos": anchor}
    losses: dict[str, Any] = {
        "damping": float(np.ravel(model.dof_damping[dof])[0]),
        "friction": float(model.dof_frictionloss[dof]),
        "stiffness": float(np.ravel(model.jnt_stiffness[j])[0]),
        "armature": float(model.dof_armature[dof]),
    }
    if kind == _J.mjJNT_BALL:
        upper = float(min(model.jnt_range[j, 1], np.pi)) if limited else 0.0
        return JointSpec.model_construct(**common, **losses, type="ball", upper=upper)
    if kind == _J.mjJNT_FREE:
        raise SpecError(f"{path}: joint {name} is a free joint within an object")
    slide = kind == _J.mjJNT_SLIDE
    initial_position = float(model.qpos0[model.jnt_qposadr[j]])
    lower, upper = (float(v) - initial_position for v in model.jnt_range[j])
    if slide and not limited:
        raise SpecError(f"{path}: joint {name} is a slide joint without limits")
    if limited and not lower < upper:
        raise SpecError(f"{path}: joint {name}: its range {lower:g} to {upper:g} is empty")
    if (
        losses["stiffness"] > 0
        and abs(float(model.qpos_spring[model.jnt_qposadr[j]]) - initial_position) > 1e-9
    ):
        notes.append(f"joint {name}: the rest position of its spring is not imported")
    force = float(model.jnt_actfrcrange[j, 1]) if model.jnt_actfrclimited[j] else 0.0
    return JointSpec.model_construct(
        **common,
        **losses,
        type="prismatic" if slide else "revolute" if limited else "continuous",
        axis=triple(data.xaxis[j]),
        lower=lower if limited else 0.0,
        upper=upper if limited else 0.0,
        effort=force if force > 0 else None,
        mimic=mimics.get(j),
    )


def _mimics(model: mujoco.MjModel, notes: list[str]) -> dict[int, Mimic]:
    """Return the `Mimic` of each joint that a joint equality constrains, by joint index."""
    mimics: dict[int, Mimic] = {}
    for e in range(model.neq):
        if model.eq_type[e] != mujoco.mjtEq.mjEQ_JOINT or model.eq_obj2id[e] < 0:
            notes.append("an equality other than between two joints is not imported")
            continue
        if np.any(model.eq_data[e, 2:5]):
            notes.append("only the linear part of a joint equality is imported")
        leader = model.joint(int(model.eq_obj2id[e])).name
        offset, multiplier = (float(v) for v in model.eq_data[e, :2])
        mimics[int(model.eq_obj1id[e])] = Mimic.model_construct(
            joint=leader, multiplier=multiplier, offset=offset
        )
    return mimics


def _geoms_below(model: mujoco.MjModel, body: int) -> bool:
    return bool(np.any(model.body_rootid[model.geom_bodyid] == body))


def _name(model: mujoco.MjModel, body: int) -> str:
    return model.body(body).name or f"body_{body}"
