"""Writes SDF of an object or a scene, for Gazebo.

Link frames are those of `link_frames`. SDF can store neither joint positions nor armature, so all
joints are at zero. The links, joints and frames of a model share one namespace, so an underscore is
appended to the name of a joint if a link has the same name.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ..io.names import unused
from ..spec import (
    GeomSpec,
    JointSpec,
    Material,
    ObjectSpec,
    PartSpec,
    SceneSpec,
    inertial,
    world_poses,
)
from ..spec.convex import Piece
from ..spec.finish import finish
from ..spec.pose import Pose, pose, to_rpy
from .link_frames import TENSOR_ENTRIES, frames, inertia_tensor, link_names, link_origins
from .write_glb import collision_file, number, numbers, visual_file

VERSION = "1.11"
"""First SDF version that supports mimic joints."""


def sdf_text(scene: SceneSpec | ObjectSpec) -> str:
    """Return a scene as an SDF world, or an object as an SDF model; meshes are separate files."""
    root = ET.Element("sdf", version=VERSION)
    if isinstance(scene, ObjectSpec):
        _add_model(root, scene.name, scene, "")
    else:
        world = ET.SubElement(root, "world", name=scene.name)
        _put(world, "gravity", scene.gravity)
        _add_sun(world)
        poses = world_poses(scene)
        for item in scene.objects:
            model = _add_model(world, item.name, item.spec, f"objects/{item.name}/")
            _pose(model, poses[item.name])
            if item.static:
                if any(joint.type != "fixed" for joint in item.spec.joints):
                    hold = ET.SubElement(model, "joint", name="hold_in_world_", type="fixed")
                    ET.SubElement(hold, "parent").text = "world"
                    ET.SubElement(hold, "child").text = link_names(item.spec)[item.spec.root]
                else:
                    ET.SubElement(model, "static").text = "true"
    ET.indent(root, " ")
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _put(parent: ET.Element, tag: str, values: Iterable[float] | float) -> ET.Element:
    element = ET.SubElement(parent, tag)
    element.text = number(values) if isinstance(values, float | int) else numbers(values)
    return element


def _pose(parent: ET.Element, local: Pose) -> ET.Element:
    return _put(parent, "pose", (*local.pos, *to_rpy(local.quat)))


def _add_sun(world: ET.Element) -> None:
    sun = ET.SubElement(world, "light", name="sun_", type="directional")
    _put(sun, "diffuse", (0.8, 0.8, 0.8, 1.0))
    _put(sun, "direction", (0.3, -0.4, -1.0))


def _add_model(parent: ET.Element, name: str, spec: ObjectSpec, folder: str) -> ET.Element:
    model = ET.SubElement(parent, "model", name=name)
    origins, links = link_origins(spec), link_names(spec)
    for part, _ in spec.ordered:
        link = ET.SubElement(model, "link", name=links[part.name])
        _fill_link(link, spec, part, origins[part.name], folder)
    # The name of a joint must differ from the names of all links and other joints.
    names, taken = {joint.name: joint.name for joint in spec.joints}, set(links.values())
    for name in names.keys() & taken:
        names[name] = unused(f"{name}_", taken | names.keys())
    for joint in spec.joints:
        _add_joint(model, joint, names, links)
    taken |= set(names.values())
    for frame in frames(spec):
        label = unused(frame.name, taken)
        taken.add(label)
        attached = {"name": label, "attached_to": links[frame.part]}
        offset = np.array(frame.pos) - origins[frame.part]
        _pose(ET.SubElement(model, "frame", attached), pose(offset))
    return model


def _fill_link(
    link: ET.Element, spec: ObjectSpec, part: PartSpec, origin: NDArray, folder: str
) -> None:
    _pose(link, pose(origin))
    mass = inertial(spec, part)
    element = ET.SubElement(link, "inertial")
    _pose(element, pose(np.array(mass.pos) - origin))
    _put(element, "mass", mass.mass)
    tensor, inertia = inertia_tensor(spec, part), ET.SubElement(element, "inertia")
    for key, index in TENSOR_ENTRIES.items():
        _put(inertia, key, float(tensor[index]))
    for geom in part.geoms:
        material = spec.material(geom.material)
        local = Pose(np.array(geom.pos) - origin, np.array(geom.quat))
        if geom.role != "collision":
            visual = ET.SubElement(link, "visual", name=geom.name)
            _pose(visual, local)
            _shape(visual, geom.shape.primitive(), f"{folder}{visual_file(geom)}")
            _add_material(visual, material)
        if geom.role != "visual":
            for k, piece in enumerate(geom.shape.pieces()):
                _add_collision(link, geom, k, piece, local, material, folder)


def _add_collision(
    link: ET.Element,
    geom: GeomSpec,
    k: int,
    piece: Piece,
    local: Pose,
    material: Material,
    folder: str,
) -> None:
    collision = ET.SubElement(link, "collision", name=f"{geom.name}-{k}")
    _pose(collision, local.then(pose(piece.pos, piece.quat)))
    _shape(collision, None if piece.kind == "mesh" else piece, folder + collision_file(geom, k))
    friction = ET.SubElement(ET.SubElement(collision, "surface"), "friction")
    ode = ET.SubElement(friction, "ode")
    for name in ("mu", "mu2"):
        _put(ode, name, material.friction)


def _shape(parent: ET.Element, piece: Piece | None, file: str) -> None:
    geometry = ET.SubElement(parent, "geometry")
    if piece is None:
        mesh = ET.SubElement(geometry, "mesh")
        ET.SubElement(mesh, "uri").text = file
        return
    shape = ET.SubElement(geometry, piece.kind)
    if piece.kind == "box":
        _put(shape, "size", [2 * v for v in piece.size])
    elif piece.kind == "ellipsoid":
        _put(shape, "radii", piece.size)
    else:
        _put(shape, "radius", piece.size[0])
        if piece.kind != "sphere":
            _put(shape, "length", 2 * piece.size[1])


def _add_material(visual: ET.Element, material: Material) -> None:
    element = ET.SubElement(visual, "material")
    for tag in ("ambient", "diffuse"):
        _put(element, tag, material.rgba)
    metallic, roughness, _ = finish(material)
    metal = ET.SubElement(ET.SubElement(element, "pbr"), "metal")
    _put(metal, "metalness", metallic)
    _put(metal, "roughness", roughness)


def _add_joint(
    model: ET.Element, joint: JointSpec, names: dict[str, str], links: dict[str, str]
) -> None:
    element = ET.SubElement(model, "joint", name=names[joint.name], type=joint.type)
    ET.SubElement(element, "parent").text = links[joint.parent]
    ET.SubElement(element, "child").text = links[joint.child]
    if joint.type == "fixed":
        return
    axis = ET.SubElement(element, "axis")
    if joint.type != "ball":
        _put(axis, "xyz", joint.axis)
        if joint.mimic is not None:
            leader = names[joint.mimic.joint]
            mimic = ET.SubElement(axis, "mimic", joint=leader, axis="axis")
            _put(mimic, "multiplier", joint.mimic.multiplier)
            _put(mimic, "offset", joint.mimic.offset)
            _put(mimic, "reference", 0.0)
        limit = ET.SubElement(axis, "limit")
        if joint.type != "continuous":
            _put(limit, "lower", joint.lower)
            _put(limit, "upper", joint.upper)
        for tag, value in (("effort", joint.effort), ("velocity", joint.velocity)):
            if value is not None:
                _put(limit, tag, value)
    dynamics = ET.SubElement(axis, "dynamics")
    _put(dynamics, "damping", joint.damping)
    _put(dynamics, "friction", joint.friction)
    if joint.stiffness:
        _put(dynamics, "spring_reference", 0.0)
        _put(dynamics, "spring_stiffness", joint.stiffness)
