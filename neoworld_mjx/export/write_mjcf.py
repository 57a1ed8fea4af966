"""Writes MJCF of a scene or one object, with full precision.

MuJoCo's writer rounds numbers to six digits. Rounding moves bodies by micrometers, and can violate
the triangle inequality of the inertia of thin plates. Therefore this module replaces all rounded
numbers, so that the file compiles to exactly the same model. Meshes are the files that URDF also
uses, because other readers of MJCF do not support inline vertices.

Visual geoms have materials named <object>-<material>. MuJoCo multiplies a texture by the color of
the material, so textured materials are white. The plain color of a textured material is stored in
<numeric name="<object>-<material>-rgb">, for readers that ignore textures.

The file can be included in, or attached to, the MJCF of a robot, because it has no settings that
would conflict. The physics is that of the search and of the final check (`physics.mjcf`).
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable
from typing import Any, Literal

import mujoco
import numpy as np

from ..physics.lowering import lower_geoms
from ..physics.mjcf import COLLISION_GROUP, VISUAL_GROUP, to_mjspec, visual_name
from ..spec import Material, ObjectSpec, SceneSpec
from ..spec.finish import finish
from .link_frames import frames, link_origins
from .write_glb import FOLDER, has_texture, is_textured, numbers, texture_file, visible_surface

HIDDEN_GROUP = 3
"""Geom group of colliders in exported files; viewers show only groups 0 to 2 by default."""
FLOOR_M = 5.0
"""Half the edge length of the visible floor [m]; the floor's collider is infinite."""
SITE_RADIUS_M = 0.005
BACKDROP_SIZE = 2.0
"""Half the edge length of the exported backdrop, relative to the distance of the backdrop."""
COLOR_SUFFIX = "-rgb"
"""Suffix of the name of a textured material's plain color."""


def mjcf_text(
    scene: SceneSpec | ObjectSpec,
    *,
    target: Literal["mujoco", "mjx"] = "mujoco",
    floor: float | None = None,
) -> str:
    """Return the MJCF of a scene or a free object, with visual geoms. Meshes are separate files.

    Each movable joint has position and velocity sensors, and each handle has a site and a touch
    sensor.

    Args:
        scene: the scene or object.
        target: if "mjx", write only features that MJX supports: polyhedra (stored in the file)
            instead of cylinders and ellipsoids, pyramidal friction cones, and no textures.
        floor: height of an infinite floor [m]; if None, there is no floor.
    """
    model = to_mjspec(scene, visual=True)
    if isinstance(scene, SceneSpec):
        objects = [(item.name, item.spec, f"objects/{item.name}/") for item in scene.objects]
    else:
        objects = [(scene.name, scene, "")]
    lowered = lower_geoms(model) if target == "mjx" else frozenset()
    if target == "mjx":
        model.option.cone, model.option.impratio = mujoco.mjtCone.mjCONE_PYRAMIDAL, 1.0
    for geom in model.geoms:
        if geom.group == COLLISION_GROUP:
            geom.group = HIDDEN_GROUP
    model.worldbody.add_light(
        name="key",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[0, 0, 3],
        dir=[0.3, -0.4, -1.0],
        diffuse=[0.6, 0.6, 0.6],
        castshadow=True,
    )
    if floor is not None:
        model.worldbody.add_geom(
            name="floor",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=[FLOOR_M, FLOOR_M, 0.1],
            pos=[0, 0, floor],
            rgba=[0.6, 0.6, 0.6, 1.0],
        )
    if isinstance(scene, SceneSpec) and scene.backdrop is not None:
        far, eye = scene.backdrop.x, 0.0 if scene.camera is None else scene.camera.height
        model.worldbody.add_geom(
            name="backdrop",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=[BACKDROP_SIZE * far, BACKDROP_SIZE * far, 0.1],
            pos=[far, 0, eye],
            quat=[math.sqrt(0.5), 0, -math.sqrt(0.5), 0],
            rgba=[*scene.backdrop.rgb, 1.0],
            group=VISUAL_GROUP,
            contype=0,
            conaffinity=0,
        )
    for name, spec, _ in objects:
        add_frames(model, name, spec)
        if target != "mjx":
            _add_surfaces(model, name, spec)
    model.compile()
    root = ET.fromstring(model.to_xml())
    _restore_precision(root, model)
    _remove_settings(root)
    folders = {name: folder for name, _, folder in objects}
    for mesh in root.iter("mesh"):
        if (name := str(mesh.get("name"))) not in lowered:
            _name_file(mesh, name, folders)
    for name, spec, folder in objects:
        _add_materials(root, name, spec, folder, textured=target != "mjx")
    ET.indent(root, " ")
    return ET.tostring(root, encoding="unicode") + "\n"


def add_frames(model: mujoco.MjSpec, owner: str, spec: ObjectSpec) -> None:
    """Add sites for handles, and sensors for handles and joints."""
    existing = {site.name for site in spec.sites}
    origins = link_origins(spec)
    sensor = mujoco.mjtSensor
    for frame in frames(spec):
        name = f"{owner}-{frame.name}"
        if frame.name in existing:
            model.site(name).size = [SITE_RADIUS_M] * 3
            continue
        body = model.body(owner if frame.part == spec.root else f"{owner}-{frame.part}")
        body.add_site(
            name=name,
            pos=np.array(frame.pos) - origins[frame.part],
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=frame.half,
            group=4,
        )
        model.add_sensor(
            name=f"{name}-touch",
            type=sensor.mjSENS_TOUCH,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=name,
        )
    for joint in spec.joints:
        if joint.type == "fixed":
            continue
        name = f"{owner}-{joint.name}"
        kinds = {"pos": sensor.mjSENS_JOINTPOS, "vel": sensor.mjSENS_JOINTVEL}
        if joint.type == "ball":
            kinds = {"pos": sensor.mjSENS_BALLQUAT, "vel": sensor.mjSENS_BALLANGVEL}
        for suffix, kind in kinds.items():
            model.add_sensor(
                name=f"{name}-{suffix}",
                type=kind,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=name,
            )


def _add_surfaces(model: mujoco.MjSpec, owner: str, spec: ObjectSpec) -> None:
    """Replace textured primitives by meshes, because MuJoCo does not texture all of their sides."""
    for part in spec.parts:
        for geom in part.geoms:
            if not is_textured(spec, geom) or geom.shape.primitive() is None:
                continue
            visual = model.geom(visual_name(owner, geom))
            vertices, faces, _ = visible_surface(spec, part.name, geom)
            mesh = model.add_mesh(
                name=visual.name, uservert=vertices.ravel(), userface=faces.ravel()
            )
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            visual.type, visual.meshname = mujoco.mjtGeom.mjGEOM_MESH, visual.name
            visual.size = np.zeros(3)


def _add_materials(
    root: ET.Element, owner: str, spec: ObjectSpec, folder: str, *, textured: bool
) -> None:
    """Replace the colors of an object's visual geoms by materials.

    Args:
        root: root element of the MJCF file.
        owner: name of the object in the file.
        spec: the object.
        folder: folder of the object's files, relative to the MJCF file: "" or "objects/cup/".
        textured: if True, materials may have textures.
    """
    visuals = {g.get("name"): g for g in root.iter("geom") if g.get("name") is not None}
    assets = _section(root, "asset")
    added: set[str] = set()
    for part in spec.parts:
        for geom in part.geoms:
            element = visuals.get(visual_name(owner, geom))
            if element is None:
                continue
            material = spec.material(geom.material)
            name = f"{owner}-{material.name}"
            element.attrib.pop("rgba", None)
            element.set("material", name)
            if name not in added:
                added.add(name)
                file = folder + texture_file(material) if textured else None
                _add_material(root, assets, name, material, file)


def _add_material(
    root: ET.Element, assets: ET.Element, name: str, material: Material, file: str | None
) -> None:
    surface = finish(material)
    look = {
        "name": name,
        "rgba": numbers(material.rgba),
        "specular": numbers([round(0.1 + 0.6 * (1 - surface.roughness), 6)]),
        "shininess": numbers([round(1 - surface.roughness, 6)]),
        "metallic": numbers([surface.metallic]),
        "roughness": numbers([surface.roughness]),
    }
    if has_texture(material) and file is not None:
        ET.SubElement(assets, "texture", name=name, type="2d", file=file)
        look |= {"texture": name, "rgba": numbers([1, 1, 1, material.rgba[3]])}
        custom = _section(root, "custom")
        plain = {"name": name + COLOR_SUFFIX, "data": numbers(material.rgba[:3])}
        ET.SubElement(custom, "numeric", plain)
    ET.SubElement(assets, "material", look)


def _section(root: ET.Element, tag: str) -> ET.Element:
    section = root.find(tag)
    return ET.SubElement(root, tag) if section is None else section


def _remove_settings(root: ET.Element) -> None:
    """Remove settings that could conflict with a file that includes this one."""
    for compiler in root.iter("compiler"):
        # All bodies state their inertia.
        compiler.attrib.pop("inertiafromgeom", None)
    for size in root.findall("size"):
        size.attrib.pop("nkey", None)
        if not size.attrib:
            root.remove(size)


def _name_file(mesh: ET.Element, name: str, folders: dict[str, str]) -> None:
    """Replace the inline data of a mesh by the path of the mesh's file."""
    owner, geom, piece = name.split("-")
    for attribute in ("vertex", "normal", "face", "texcoord"):
        mesh.attrib.pop(attribute, None)
    file = f"{geom}.obj" if piece == "visual" else f"{geom}-{piece}.obj"
    mesh.set("file", f"{folders[owner]}{FOLDER}/{file}")


def _restore_precision(root: ET.Element, model: mujoco.MjSpec) -> None:
    """Replace the rounded numbers in an XML tree by the exact numbers of the specification."""
    option = root.find("option")
    if option is not None:
        _exact(option, model.option, {"timestep": "timestep", "gravity": "gravity"})
    pose = {"pos": "pos", "quat": "quat"}
    finders: dict[str, tuple[Callable[[str], Any], dict[str, str]]] = {
        "body": (model.body, pose),
        "geom": (model.geom, {**pose, "size": "size", "friction": "friction", "rgba": "rgba"}),
        "joint": (
            model.joint,
            {
                "pos": "pos",
                "axis": "axis",
                "range": "range",
                "actuatorfrcrange": "actfrcrange",
                "damping": "damping",
                "frictionloss": "frictionloss",
                "stiffness": "stiffness",
                "armature": "armature",
            },
        ),
        "site": (model.site, {**pose, "size": "size"}),
        "camera": (model.camera, {**pose, "fovy": "fovy"}),
        "mesh": (model.mesh, {"vertex": "uservert"}),
        "key": (model.key, {"qpos": "qpos"}),
    }
    for element in root.iter():
        name = element.get("name")
        if element.tag in finders and name is not None:
            find, attributes = finders[element.tag]
            _exact(element, find(name), attributes)
        if element.tag == "body" and (inertia := element.find("inertial")) is not None:
            _exact(
                inertia,
                model.body(str(name)),
                {"pos": "ipos", "quat": "iquat", "mass": "mass", "diaginertia": "inertia"},
            )
    equality = root.find("equality")
    for element in [] if equality is None else equality:
        if "polycoef" in element.attrib:
            data = model.equality(str(element.get("name"))).data
            element.set("polycoef", numbers(data[:5]))


def _exact(element: ET.Element, source: Any, attributes: dict[str, str]) -> None:
    for attribute, field in attributes.items():
        written = element.get(attribute)
        if written is None:
            continue
        value = getattr(source, field)
        values = [value] if isinstance(value, float | int) else _plain(value)
        # The size of a geom has only as many numbers as its type needs.
        element.set(attribute, numbers(values[: len(written.split())]))


def _plain(values: Iterable[object]) -> list[float]:
    array = np.asarray(values)
    if array.dtype == np.float32 or np.array_equal(array, array.astype(np.float32)):
        # The shortest decimal that gives the same single-precision number.
        return [float(str(value)) for value in array.astype(np.float32)]
    return [float(value) for value in array]
