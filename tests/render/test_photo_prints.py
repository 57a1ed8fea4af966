"""Prints of the photograph: on what faced the camera and was not covered, and nowhere else."""

import io

import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image
from pxr import Usd, UsdShade

from neoworld_mjx.errors import SpecError
from neoworld_mjx.export.formats import write_formats
from neoworld_mjx.export.write_glb import visible_surface
from neoworld_mjx.render import render
from neoworld_mjx.render.appearance import print_png, read_print
from neoworld_mjx.render.looks import printed
from neoworld_mjx.spec import Box, Camera, ObjectSpec, SceneObject, SceneSpec, read_scene
from neoworld_mjx.spec.room import PhotoPrint
from tests.support.mechanisms import WOOD, geom, joint, part

CAMERA = Camera(width=480, height_px=320, fovy=0.5, height=0.6, pitch=0.35, roll=0.0)
LEFT, RIGHT = (200, 30, 30), (30, 60, 200)


def cupboard(name: str) -> ObjectSpec:
    return ObjectSpec(
        name=name,
        materials=(WOOD.model_copy(update={"rgba": (0.2, 0.8, 0.2, 1.0)}),),
        parts=(
            part("case", geom("case", Box(size=(0.2, 0.3, 0.2)), (0, 0, 0.1))),
            part("drawer", geom("front", Box(size=(0.02, 0.28, 0.18)), (0.11, 0, 0.1))),
        ),
        joints=(joint("slide", "prismatic", "case", "drawer", axis=(1, 0, 0), upper=0.1),),
    )


@pytest.fixture(scope="module")
def scene() -> SceneSpec:
    centre = CAMERA.position() + CAMERA.axes()[:, 2] * (0.5 / np.sin(CAMERA.pitch))
    toward = np.arctan2(*(CAMERA.position() - centre)[1::-1])
    item = SceneObject(name="cupboard", spec=cupboard("cupboard"), fixed_base=True,
                       xy=tuple(centre[:2].tolist()), yaw=float(toward),
                       joint_state={"slide": 0.05})  # fmt: skip
    return SceneSpec(name="scene", objects=(item,), camera=CAMERA)


@pytest.fixture(scope="module")
def photo() -> np.ndarray:
    picture = np.zeros((640, 960, 3), np.uint8)
    picture[:, :480], picture[:, 480:] = LEFT, RIGHT
    return picture


@pytest.fixture(scope="module")
def result(scene, photo):
    return printed(scene, photo)


def test_visible_flat_faces_are_printed_and_others_keep_their_color(result):
    spec = result.objects[0].spec
    (own,) = spec.part("drawer").geoms
    material = spec.material(own.material)
    assert material.name == "wood_drawer_photo" and material.density == WOOD.density
    vertices, faces, uv = visible_surface(spec, "drawer", own)
    picture = np.asarray(Image.open(io.BytesIO(print_png(material))))
    centers, places = vertices[faces].mean(axis=1), uv.mean(axis=1)
    h, w = picture.shape[:2]
    rows = np.clip(((1 - places[:, 1]) * h).astype(int), 0, h - 1)
    colors = picture[rows, np.clip((places[:, 0] * w).astype(int), 0, w - 1)].astype(int)
    red, green, blue = (round(255 * v) for v in material.rgba[:3])
    plain = np.abs(colors - [red, green, blue]).max(axis=1) < 3
    back = centers[:, 0] < vertices[:, 0].min() + 1e-6
    front = centers[:, 0] > vertices[:, 0].max() - 1e-6
    assert plain[back].all() and back.any()
    # The camera looks from the front, so +y is to the right.
    y = centers[:, 1]
    for side, color in ((y < -0.02, LEFT), (y > 0.02, RIGHT)):
        chosen = front & side & ~plain
        assert chosen.sum() > 10
        assert np.abs(colors[chosen] - color).max() < 3


def test_rendered_prints_move_with_the_drawer(result):
    picture = render(result, CAMERA, supersample=1).color.astype(int)
    front = picture[160, 180], picture[160, 300]
    assert front[0][0] > 2 * front[0][2] and front[1][2] > 2 * front[1][0]
    item = result.objects[0].model_copy(update={"joint_state": {"slide": 0.0}})
    closed = render(result.model_copy(update={"objects": (item,)}), CAMERA, supersample=1)
    assert closed.color[160, 200][0] > 2 * closed.color[160, 200][2]


def test_formats_contain_prints_and_mark_them(result, tmp_path):
    write_formats(result, tmp_path, ["mjcf", "usd", "usdz", "glb"])
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    names = {model.texture(k).name for k in range(model.ntex)}
    assert {"cupboard-wood_case_photo", "cupboard-wood_drawer_photo"} <= names
    stage = Usd.Stage.Open(str(tmp_path / "scene.usdc"))
    look = stage.GetPrimAtPath("/scene/cupboard/looks/wood_case_photo")
    assert "photograph" in look.GetCustomDataByKey("neoworld:print")
    texture = UsdShade.Shader(stage.GetPrimAtPath(look.GetPath().AppendChild("texture")))
    assert texture.GetInput("wrapS").Get() == "clamp"
    file = texture.GetInput("file").Get().resolvedPath
    with Image.open(file) as picture:
        assert picture.size[0] > 20
    glb = trimesh.load(tmp_path / "scene.glb")
    assert any(g.visual.material.name.endswith("_photo") for g in glb.geometry.values())
    # The scene as this package reads it says so as well, and gives the same surfaces.
    (tmp_path / "scene.json").write_text(result.to_json())
    assert read_scene(tmp_path).objects[0].spec == result.objects[0].spec


def test_a_displaced_object_is_printed_with_its_own_pixels(scene, photo, result):
    from neoworld_mjx.spec.tree import Box2D

    mask = render(scene, CAMERA, supersample=1, floor=False).segmentation == 0
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    # The photograph has it farther left, where all is red.
    box = Box2D(x0=4.0, y0=float(rows[0]), x1=4.0 + columns[-1] - columns[0] + 1,
                y1=float(rows[-1] + 1))  # fmt: skip
    away = columns[0] - 4
    item = scene.objects[0].model_copy(update={"box2d": box})
    moved = printed(scene.model_copy(update={"objects": (item,)}), photo)
    # Its middle column shows what is that much farther left in the photograph, where all is red.
    colours = [
        read_print(one.objects[0].spec.material("wood_case_photo").photo).colours[0]
        for one in (moved, result)
    ]
    blue = [int((np.abs(row.astype(int) - RIGHT).max(axis=1) < 3).sum()) for row in colours]
    assert blue[1] - blue[0] == pytest.approx(min(2 * away, blue[1]), abs=3) and blue[1] > 10


def test_what_is_outside_the_photograph_is_not_printed(scene, photo):
    """The photograph cuts the object off at the top, where the rendered image shows it whole."""
    from neoworld_mjx.spec.tree import Box2D

    mask = render(scene, CAMERA, supersample=1, floor=False).segmentation == 0
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    middle = (rows[0] + rows[-1]) / 2
    box = Box2D(x0=float(columns[0]), y0=0.0, x1=float(columns[-1] + 1),
                y1=float(rows[-1] + 1 - middle))  # fmt: skip
    item = scene.objects[0].model_copy(update={"box2d": box})
    cut = printed(scene.model_copy(update={"objects": (item,)}), np.maximum(photo, 20))
    spec = cut.objects[0].spec
    materials = [material for material in spec.materials if material.photo is not None]
    assert materials
    for material in materials:
        assert read_print(material.photo).colours[0].max(axis=-1).min() > 100
        assert max(material.rgba[:3]) > 0.5


def test_invalid_print_images_are_refused():
    good = {"near": 1.0, "far": 2.0, "turn": ((1, 0, 0), (0, 1, 0), (0, 0, 1)), "shift": (0, 0, 1)}
    with pytest.raises(ValueError, match="pattern"):
        PhotoPrint(image="../etc", depth="", **good)
    flat = {**good, "turn": ((1, 0, 0), (1, 0, 0), (0, 0, 1))}
    with pytest.raises(SpecError, match="not independent"):
        read_print(PhotoPrint(image="AAAA", depth="AAAA", **flat))
    with pytest.raises(ValueError, match="finite"):
        PhotoPrint(image="AAAA", depth="AAAA", **{**good, "far": float("inf")})
    with pytest.raises(SpecError, match="not an image"):
        read_print(PhotoPrint(image="AAAA", depth="AAAA", **good))
