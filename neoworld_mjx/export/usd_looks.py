"""USD materials: a UsdPreviewSurface, a UsdUVTexture if the material is textured, and friction.

A textured material also states its plain color, which the connection to the texture overrides.
"""

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdSemantics, UsdShade, Vt

from ..render.appearance import linear
from ..spec import Material
from ..spec.finish import finish
from .textures import texture_file

PRINT_NOTE = "window of the photograph, with its light, projected on what faced the camera"


def add_material(stage: Usd.Stage, base: Sdf.Path, material: Material, *, textured: bool) -> None:
    """Define a material, for rendering and for physics, below the prim `looks` of an object.

    Args:
        stage: the stage.
        base: path of the object.
        material: the material.
        textured: if True, the object has a texture file for the material.
    """
    path = base.AppendChild("looks").AppendChild(material.name)
    look = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, path.AppendChild("surface"))
    shader.CreateIdAttr("UsdPreviewSurface")
    diffuse = shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    diffuse.Set(_color(material))
    surface = finish(material)
    if material.photo is not None:
        look.GetPrim().SetCustomDataByKey("neoworld:print", PRINT_NOTE)
    if textured:
        _add_texture(stage, path, diffuse, material)
    shader.CreateInput("opacity", Sdf.ValueTypeNames.Float).Set(material.rgba[3])
    shader.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(surface.metallic)
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(surface.roughness)
    look.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    physics = UsdPhysics.MaterialAPI.Apply(look.GetPrim())
    physics.CreateStaticFrictionAttr(material.friction)
    physics.CreateDynamicFrictionAttr(material.friction)
    physics.CreateRestitutionAttr(0.0)
    physics.CreateDensityAttr(material.density)
    add_label(look.GetPrim(), "material", material.name)


def add_label(prim: Usd.Prim, kind: str, *labels: str) -> None:
    """Add semantic labels to a prim."""
    UsdSemantics.LabelsAPI.Apply(prim, kind).CreateLabelsAttr().Set(Vt.TokenArray(list(labels)))


def _add_texture(
    stage: Usd.Stage, path: Sdf.Path, diffuse: UsdShade.Input, material: Material
) -> None:
    """Connect the input of a color to a material's texture, which repeats if it is a pattern."""
    reader = UsdShade.Shader.Define(stage, path.AppendChild("coordinates"))
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    result = reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    texture = UsdShade.Shader.Define(stage, path.AppendChild("texture"))
    texture.CreateIdAttr("UsdUVTexture")
    file = Sdf.AssetPath(f"./{texture_file(material)}")
    texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(file)
    texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB")
    for edge in ("wrapS", "wrapT"):
        texture.CreateInput(edge, Sdf.ValueTypeNames.Token).Set(
            "repeat" if material.photo is None else "clamp"
        )
    texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(result)
    diffuse.ConnectToSource(texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3))


def bind_material(
    stage: Usd.Stage, path: Sdf.Path, base: Sdf.Path, material: Material, *, physical: bool
) -> None:
    """Bind a material to a prim; if `physical`, bind the material only for physics."""
    prim = stage.GetPrimAtPath(path)
    look = UsdShade.Material.Get(stage, base.AppendChild("looks").AppendChild(material.name))
    UsdGeom.Gprim(prim).CreateDisplayColorAttr(Vt.Vec3fArray([_color(material)]))
    if material.rgba[3] < 1:
        UsdGeom.Gprim(prim).CreateDisplayOpacityAttr(Vt.FloatArray([material.rgba[3]]))
    binding = UsdShade.MaterialBindingAPI.Apply(prim)
    if physical:
        binding.Bind(look, UsdShade.Tokens.weakerThanDescendants, "physics")
    else:
        binding.Bind(look)


def _color(material: Material) -> Gf.Vec3f:
    """Return the color of a material in linear light."""
    return Gf.Vec3f(*np.round(linear(np.array(material.rgba[:3])), 6).tolist())
