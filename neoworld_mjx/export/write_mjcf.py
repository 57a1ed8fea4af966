"""MJCF of a scene or one object: one self-contained file that compiles to the very same model.

MuJoCo's own writer rounds to six digits. That moves bodies by micrometres, and of thin plates it
can break A + B >= C of the inertia, so every number is written again in full.
"""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable
from typing import Any

import mujoco
import numpy as np

from ..physics.mjcf import COLLISION_GROUP, to_mjspec
from ..spec import ObjectSpec, SceneSpec
from .meshes import numbers

HIDDEN_GROUP = 3
"""Group of colliders in exported files: viewers show groups 0 to 2 at first."""


def mjcf_text(scene: SceneSpec | ObjectSpec, *, timestep: float = 0.002) -> str:
    """Return a scene, or one free object, as MJCF with visual geoms and without other files.

    Args:
        scene: what to write.
        timestep: of the simulation [s].
    """
    model = to_mjspec(scene, visual=True, timestep=timestep)
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
    model.compile()
    root = ET.fromstring(model.to_xml())
    _restore(root, model)
    ET.indent(root, " ")
    return ET.tostring(root, encoding="unicode") + "\n"


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
        "site": (model.site, place),
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


__all__ = ["HIDDEN_GROUP", "mjcf_text"]
