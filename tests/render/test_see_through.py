"""Glass in pictures and exports: what is behind and in it shows, and it is seen itself."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdShade

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.export import export_object, mjcf_text
from neoworld_mjx.program.building import run
from neoworld_mjx.program.supports import MATERIALS
from neoworld_mjx.render import View, render, render_plain
from neoworld_mjx.render.ray_caster import RayCaster
from neoworld_mjx.render.rendering import compile_posed
from neoworld_mjx.spec import Box, Lathe, Material, ObjectSpec, SceneObject, SceneSpec, Sphere
from tests.support.mechanisms import geom, part

RED = Material(name="paint", density=500, rgba=(0.9, 0.05, 0.05, 1))
SIZE = 81
VIEW = View.look_at((0.6, 0, 0.05), (0, 0, 0.05), width=SIZE, height=SIZE)


def scene(alpha: float, shape=None) -> SceneSpec:
    """A red ball of 3 cm in a vessel, or behind a pane, of glass."""
    glass = Material(name="glass", density=2500, rgba=(0.8, 0.9, 0.9, alpha))
    shape = shape or Lathe(profile=((0, 0), (0.06, 0), (0.06, 0.1)), thickness=0.003)
    at = (0.1, 0, 0.05) if isinstance(shape, Box) else (0, 0, 0)
    jar = part("body", geom("body", shape, at, "glass"))
    ball = part("body", geom("body", Sphere(radius=0.03), (0, 0, 0.05), "paint"))
    return SceneSpec(
        objects=(
            SceneObject(name="jar", spec=ObjectSpec(name="jar", materials=(glass,), parts=(jar,))),
            SceneObject(name="ball", spec=ObjectSpec(name="ball", materials=(RED,), parts=(ball,))),
        )
    )


def redness(image: np.ndarray) -> float:
    r, g, b = image[SIZE // 2, SIZE // 2].astype(float)
    return float(r - (g + b) / 2)


@pytest.mark.parametrize("draw", ["plain", "full"])
@pytest.mark.parametrize("shape", [None, Box(size=(0.004, 0.2, 0.2))], ids=["jar", "pane"])
def test_objects_in_or_behind_glass_are_visible(draw, shape):
    def picture(alpha):
        it = scene(alpha, shape)
        return render_plain(it, VIEW) if draw == "plain" else render(it, VIEW, floor=False).color

    opaque, clear = picture(1.0), picture(0.3)
    assert redness(opaque) < 10
    assert redness(clear) > 30
    # Less of it than without the glass, which is itself seen beside the ball.
    assert redness(clear) < redness(picture(0.01))
    if shape is None:
        side = clear[SIZE // 2, SIZE // 2 + 12].astype(int)
        assert np.abs(side - picture(0.01)[SIZE // 2, SIZE // 2 + 12]).max() > 3


def test_glass_attenuates_light():
    shares = {}
    for alpha in (0.25, 1.0):
        caster = RayCaster(*compile_posed(scene(alpha, Box(size=(0.004, 0.2, 0.2)))))
        source = np.array([1.0, 0.0, 0.05])
        points = np.array([[0.05, 0.0, 0.05], [-0.2, 0.0, 0.05], [0.05, 0.5, 0.05]])
        shares[alpha] = caster.visible(source, points).tolist()
    assert shares[0.25] == pytest.approx([0.75, 0.0, 1.0])
    assert shares[1.0] == [0.0, 0.0, 1.0]


PROGRAM = """from neoworld_mjx.program.sdk import Object, box

thing = Object("thing")
body = thing.part("body", material="glass")
body.add(box((0.1, 0.1, 0.1)), name="clear")
body.add(box((0.1, 0.1, 0.1)), at=(0, 0, 0.1), rgb=(0.1, 0.1, 0.1), name="black")
thing.material("jar", like="glass", rgb=(0.8, 0.8, 0.9), alpha=0.4)
body.add(box((0.1, 0.1, 0.1)), at=(0, 0, 0.2), material="jar", name="jar")
body.add(box((0.1, 0.1, 0.1)), at=(0, 0, 0.3), material="jar", rgb=(0.5, 0.1, 0.1), name="print")
thing.material("screen", like="acrylic", rgb=(0.1, 0.1, 0.1))
body.add(box((0.1, 0.1, 0.1)), at=(0, 0, 0.4), material="screen", name="screen")
"""


def test_clear_materials_are_clear_unless_the_program_paints_them(tmp_path):
    spec = run(PROGRAM, ProgramOptions()).spec
    assert spec is not None
    alpha = {g.name: spec.material(g.material).rgba[3] for g in spec.parts[0].geoms}
    clear = MATERIALS["glass"].rgba[3]
    assert 0 < clear < 0.5
    assert alpha == {"clear": clear, "black": 1.0, "jar": 0.4, "print": 1.0, "screen": 1.0}

    model = ET.fromstring(mjcf_text(spec))
    visual = {str(g.get("name")): g for g in model.iter("geom")}["thing-jar-visual"]
    of = {m.get("name"): m for m in model.iter("material")}[visual.get("material")]
    assert str(of.get("rgba")).split()[3] == "0.4"
    export_object(spec, tmp_path)
    robot = ET.parse(tmp_path / "object.urdf").getroot()
    looks = {m.get("name"): m.find("color") for m in robot.findall("material")}
    assert looks["jar"].get("rgba").split()[3] == "0.4"
    stage = Usd.Stage.Open(str(tmp_path / "object.usda"))
    shaders = [UsdShade.Shader(p) for p in stage.Traverse() if p.IsA(UsdShade.Shader)]
    opacity = {s.GetPath().GetParentPath().name: s.GetInput("opacity").Get() for s in shaders}
    assert opacity["jar"] == pytest.approx(0.4)
    shown = {
        p.GetName(): UsdGeom.Gprim(p).GetDisplayOpacityAttr().Get()
        for p in stage.Traverse()
        if p.GetParent().GetName() == "visuals"
    }
    assert list(shown["jar"]) == pytest.approx([0.4])
    assert shown["black"] is None
