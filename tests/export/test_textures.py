"""Textures and finish of materials: the same look in every format, where it lies on surfaces."""

import io
import xml.etree.ElementTree as ET
import zipfile

import mujoco
import numpy as np
import pytest
from PIL import Image
from pxr import Usd, UsdGeom, UsdShade, UsdValidation

from neoworld_mjx.export.formats import write_formats
from neoworld_mjx.export.write_glb import visible_surface
from neoworld_mjx.render.appearance import linear
from neoworld_mjx.render.surface_patterns import patterned
from neoworld_mjx.render.tiles import tile_png, tile_size
from neoworld_mjx.spec import Box, Cylinder, Material, ObjectSpec, SurfacePattern
from tests.support.mechanisms import geom, joint, part

TILED = SurfacePattern(kind="tiles", step=0.05, rgb=(0.1, 0.1, 0.1))


@pytest.fixture(scope="module")
def spec() -> ObjectSpec:
    """A tiled box on a slide beside a cylinder of oak, a plain knob, and a clear lid."""
    looks = (
        Material(name="oak", density=700, rgba=(0.6, 0.4, 0.2, 1)),
        Material(name="wall", density=2000, rgba=(0.8, 0.5, 0.3, 1), pattern=TILED),
        Material(name="knob", density=900, rgba=(0.2, 0.3, 0.4, 1), metallic=0.3, roughness=0.12),
        Material(name="lid", density=900, rgba=(0.5, 0.5, 0.5, 0.4)),
    )
    return ObjectSpec(
        name="thing",
        materials=looks,
        parts=(
            part("base", geom("post", Cylinder(radius=0.05, height=0.3), (0, 0, 0.15), "oak")),
            part("brick", geom("brick", Box(size=(0.2, 0.2, 0.1)), (0.15, 0, 0.1), "wall")),
            part(
                "cap",
                geom("knob", Box(size=(0.02, 0.02, 0.02)), (0, 0, 0.31), "knob"),
                geom("lid", Box(size=(0.03, 0.03, 0.002)), (0, 0, 0.321), "lid"),
            ),
        ),
        joints=(
            joint("slide", "prismatic", "base", "brick", (0.05, 0, 0.1), (1, 0, 0), upper=0.1),
            joint("cap", "fixed", "base", "cap", (0, 0, 0.3)),
        ),
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory, spec):
    out = tmp_path_factory.mktemp("looks")
    write_formats(spec, out, ["mjcf", "usd", "usdz", "glb"])
    return out


def test_a_tile_matches_the_rendered_pattern(spec):
    """Points of a board's face have the colour of the tile at their coordinates."""
    block = spec.part("brick").geoms[0]
    vertices, faces, uv = visible_surface(spec, "brick", block)
    assert uv is not None
    wide, tall = tile_size(TILED)
    # The frame of a part is at its joint, as in the pictures.
    corners = (vertices + np.array(block.pos) - np.array([0.05, 0, 0.1]))[faces]
    content = tile_png(spec.material("wall"))
    assert content is not None
    picture = np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))
    rng, seen = np.random.default_rng(0), 0
    for corner, place in zip(corners, uv, strict=True):
        weights = rng.dirichlet(np.ones(3), 40)
        point, at = weights @ corner, weights @ place
        normal = np.cross(corner[1] - corner[0], corner[2] - corner[0])
        normals = np.tile(normal / np.linalg.norm(normal), (40, 1))
        base = linear(np.array(spec.material("wall").rgba[:3]))
        drawn = patterned(
            TILED, base, linear(np.array(TILED.rgb)), point, normals, np.full(40, tall / 256)
        )
        rows = ((1 - at[:, 1] % 1) * 256).astype(int) % 256
        columns = (at[:, 0] % 1 * 256).astype(int) % 256
        away = np.abs(linear(picture[rows, columns] / 255) - drawn).max(axis=1)
        # Beside a joint a pixel is of both; brightness of each tile repeats with the picture.
        seen += int((away < 0.08).sum())
    assert seen > 0.9 * 40 * len(corners)
    assert wide == tall == pytest.approx(0.2)


def test_mjcf_has_materials_and_textures(folder, spec):
    model = mujoco.MjModel.from_xml_path(str(folder / "object.xml"))
    wall = model.material("thing-wall")
    texture = model.texture(int(wall.texid[mujoco.mjtTextureRole.mjTEXROLE_RGB]))
    assert (texture.height[0], texture.width[0]) == (256, 256)
    shown = model.geom("thing-brick-visual")
    assert shown.matid[0] == wall.id and model.mesh_texcoordnum[shown.dataid[0]] > 3
    knob = model.material("thing-knob")
    assert model.mat_metallic[knob.id] == pytest.approx(0.3)
    assert model.mat_roughness[knob.id] == pytest.approx(0.12)
    assert model.material("thing-lid").rgba[3] == pytest.approx(0.4)
    for element in ET.parse(folder / "object.xml").getroot().iter("texture"):
        assert (folder / element.attrib["file"]).is_file()


@pytest.mark.parametrize("file", ["object.usdc", "object.usdz"])
def test_usd_refers_to_existing_textures(folder, file):
    stage = Usd.Stage.Open(str(folder / file))
    surface = UsdShade.Shader(stage.GetPrimAtPath("/thing/looks/wall/surface"))
    source = surface.GetInput("diffuseColor").GetConnectedSources()[0][0].source
    asset = source.GetInput("file").Get()
    assert source.GetPrim().GetName() == "texture" and asset.resolvedPath
    mesh = stage.GetPrimAtPath("/thing/links/brick/visuals/brick")
    st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    assert len(st.ComputeFlattened()) == 36 and st.GetInterpolation() == UsdGeom.Tokens.faceVarying
    knob = UsdShade.Shader(stage.GetPrimAtPath("/thing/looks/knob/surface"))
    assert knob.GetInput("metallic").Get() == pytest.approx(0.3)
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    found = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [error.GetErrorAsString() for error in found] == []
    if file.endswith("usdz"):
        assert "textures/wall.png" in zipfile.ZipFile(folder / file).namelist()
