"""Materials and textures of MJCF: visual geoms have materials named <object>-<material>.

MuJoCo multiplies a texture by the color of the material, so textured materials are white. The plain
color of a textured material is stored in <numeric name="<object>-<material>-rgb">, for readers that
ignore textures.
"""

import xml.etree.ElementTree as ET

import mujoco
import numpy as np

from ..physics.mjcf import visual_name
from ..spec import Material, ObjectSpec
from ..spec.finish import finish
from .meshes import numbers
from .textures import has_texture, is_textured, texture_file, visible_surface

COLOR_SUFFIX = "-rgb"


def add_surfaces(model: mujoco.MjSpec, owner: str, spec: ObjectSpec) -> None:
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


def add_materials(
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


def geom_color(model: mujoco.MjModel, g: int) -> tuple[float, float, float, float]:
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


def _section(root: ET.Element, tag: str) -> ET.Element:
    section = root.find(tag)
    return ET.SubElement(root, tag) if section is None else section
