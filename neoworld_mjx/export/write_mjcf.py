"""MJCF of a scene or one object, which compiles to the very same model.

MuJoCo's own writer rounds to six digits. That moves bodies by micrometres, and of thin plates it
can break A + B >= C of the inertia, so every number is written again in full. Meshes are the files
that URDF uses: other readers of MJCF know no vertices inside of it.

The files can be included or attached beside a robot: they set nothing that such a file would have
to agree with. Contacts are elliptic, with stiff friction, so that nothing creeps.
"""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable
from typing import Any, Literal

import mujoco
import numpy as np

from ..physics.lowering import lower_geoms
from ..physics.mjcf import COLLISION_GROUP, to_mjspec
from ..spec import ObjectSpec, SceneSpec
from .handles import frames
from .meshes import FOLDER, numbers
from .mjcf_looks import add_materials, add_surfaces

HIDDEN_GROUP = 3
"""Group of colliders in exported files: viewers show groups 0 to 2 at first."""
IMPRATIO = 10.0
"""Stiffness of friction over that of the normal force; at 1 resting cups creep by millimetres."""
FLOOR_M = 5.0
"""Half the edge of a floor's drawn plane [m]; it collides without end."""
SITE_RADIUS_M = 0.005


def mjcf_text(
    scene: SceneSpec | ObjectSpec,
    *,
    timestep: float = 0.002,
    target: Literal["mujoco", "mjx"] = "mujoco",
    floor: float | None = None,
) -> str:
    """Return a scene, or one free object, as MJCF with visual geoms; meshes are files beside it.

    Every joint has sensors of position and velocity, and every handle a site and a touch sensor.

    Args:
        scene: what to write.
        timestep: of the simulation [s].
        target: "mjx" writes only colliders that MJX has: polyhedra in place of cylinders and
            ellipsoids, within the file, pyramidal contacts, and no textures.
        floor: height of a floor without end [m]; None writes none.
    """
    model = to_mjspec(scene, visual=True, timestep=timestep)
    if isinstance(scene, SceneSpec):
        objects = [(item.name, item.spec, f"objects/{item.name}/") for item in scene.objects]
    else:
        objects = [(scene.name, scene, "")]
    lowered = lower_geoms(model) if target == "mjx" else frozenset()
    if target != "mjx":
        model.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        model.option.impratio = IMPRATIO
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
    for name, spec, _ in objects:
        _add_frames(model, name, spec)
        if target != "mjx":
            add_surfaces(model, name, spec)
    model.compile()
    root = ET.fromstring(model.to_xml())
    _restore(root, model)
    _free_of_settings(root)
    folders = {name: folder for name, _, folder in objects}
    for mesh in root.iter("mesh"):
        if (name := str(mesh.get("name"))) not in lowered:
            _name_file(mesh, name, folders)
    for name, spec, folder in objects:
        add_materials(root, name, spec, folder, textured=target != "mjx")
    ET.indent(root, " ")
    return ET.tostring(root, encoding="unicode") + "\n"


def _add_frames(model: mujoco.MjSpec, owner: str, spec: ObjectSpec) -> None:
    """Add handles as sites, and sensors of handles and joints."""
    given = {site.name for site in spec.sites}
    origins = {joint.child: np.array(joint.pos) for joint in spec.joints}
    sensor = mujoco.mjtSensor
    for frame in frames(spec):
        name = f"{owner}-{frame.name}"
        if frame.name in given:
            model.site(name).size = [SITE_RADIUS_M] * 3
            continue
        body = model.body(owner if frame.part == spec.root else f"{owner}-{frame.part}")
        body.add_site(
            name=name,
            pos=np.array(frame.pos) - origins.get(frame.part, np.zeros(3)),
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=frame.half,
            group=4,
        )
        _sense(model, f"{name}-touch", sensor.mjSENS_TOUCH, mujoco.mjtObj.mjOBJ_SITE, name)
    for joint in spec.joints:
        if joint.type == "fixed":
            continue
        name = f"{owner}-{joint.name}"
        kinds = {"pos": sensor.mjSENS_JOINTPOS, "vel": sensor.mjSENS_JOINTVEL}
        if joint.type == "ball":
            kinds = {"pos": sensor.mjSENS_BALLQUAT, "vel": sensor.mjSENS_BALLANGVEL}
        for kind, sort in kinds.items():
            _sense(model, f"{name}-{kind}", sort, mujoco.mjtObj.mjOBJ_JOINT, name)


def _sense(
    model: mujoco.MjSpec, name: str, kind: mujoco.mjtSensor, of: mujoco.mjtObj, which: str
) -> None:
    model.add_sensor(name=name, type=kind, objtype=of, objname=which)


def _free_of_settings(root: ET.Element) -> None:
    """Drop what a file that includes this one beside a robot would have to agree with."""
    for compiler in root.iter("compiler"):
        # Every body states its inertia, so nothing is inferred in any case.
        compiler.attrib.pop("inertiafromgeom", None)
    for size in root.findall("size"):
        size.attrib.pop("nkey", None)
        if not size.attrib:
            root.remove(size)


def _name_file(mesh: ET.Element, name: str, folders: dict[str, str]) -> None:
    """Replace a mesh's numbers by the file that holds them."""
    owner, geom, piece = name.split("-")
    for numbers_of in ("vertex", "normal", "face", "texcoord"):
        mesh.attrib.pop(numbers_of, None)
    file = f"{geom}.obj" if piece == "visual" else f"{geom}-{piece}.obj"
    mesh.set("file", f"{folders[owner]}{FOLDER}/{file}")


def _restore(root: ET.Element, model: mujoco.MjSpec) -> None:
    """Write the numbers of a specification over their rounded copies in its XML."""
    option = root.find("option")
    if option is not None:
        _exact(option, model.option, {"timestep": "timestep", "gravity": "gravity"})
    place = {"pos": "pos", "quat": "quat"}
    finders: dict[str, tuple[Callable[[str], Any], dict[str, str]]] = {
        "body": (model.body, place),
        "geom": (model.geom, {**place, "size": "size", "friction": "friction", "rgba": "rgba"}),
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
        "site": (model.site, {**place, "size": "size"}),
        "camera": (model.camera, {**place, "fovy": "fovy"}),
        "mesh": (model.mesh, {"vertex": "uservert"}),
        "key": (model.key, {"qpos": "qpos"}),
    }
    for element in root.iter():
        name = element.get("name")
        if element.tag in finders and name is not None:
            find, attributes = finders[element.tag]
            # In MJCF <mesh name> is an asset and <geom mesh> a use; <site> etc. are alike here.
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
        # MJCF gives only the leading numbers that a geom's type needs.
        element.set(attribute, numbers(values[: len(written.split())]))


def _plain(values: Iterable[object]) -> list[float]:
    array = np.asarray(values)
    if array.dtype == np.float32 or np.array_equal(array, array.astype(np.float32)):
        # Shortest decimal that gives the same single-precision number.
        return [float(str(value)) for value in array.astype(np.float32)]
    return [float(value) for value in array]
