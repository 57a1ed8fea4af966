"""Programs of supports: they fill their outline, and only there they carry."""

import mujoco
import numpy as np
import pytest

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.physics.mjcf import to_mjspec
from neoworld_mjx.program.sandbox import run
from neoworld_mjx.program.supports import LEG_M, MATERIALS, leg_positions, support_program
from neoworld_mjx.spec import (
    Box,
    Box2D,
    Box3D,
    ObjectSpec,
    SceneObject,
    SceneSpec,
    SupportOutline,
    SupportSurface,
    SurfacePattern,
    TreeNode,
    bounds,
)
from neoworld_mjx.spec.triangles import loops_distance
from tests.support.scenes import single

L_SHAPE = SupportOutline(
    shape="polygon",
    points=((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (0.0, 0.5), (0.0, 0.0), (-0.5, 0.0)),
)
ROUND = SupportOutline(shape="round")
TALL, SLAB = (1.0, 1.4, 0.7), (1.0, 1.4, 0.03)


def node_of(outline: SupportOutline, size: tuple[float, float, float]) -> TreeNode:
    return TreeNode(
        name="top",
        label="table top" if size[2] < 0.1 else "table",
        description="oak",
        environment=True,
        box2d=Box2D(x0=0, y0=0, x1=9, y1=9),
        box3d=Box3D(position=(0, 0, 0), size=size),
        outline=outline,
    )


def support(outline: SupportOutline, size: tuple[float, float, float]) -> ObjectSpec:
    built = run(support_program(node_of(outline, size)), ProgramOptions())
    assert built.spec is not None, built.signals
    return built.spec


def falls(top: ObjectSpec, places: list[tuple[float, float]]) -> list[bool]:
    """Tell which cubes of 6 cm, set down at places on a fixed top, leave it within a second."""
    height = float(bounds(top)[1][2])
    cube = single("cube", (Box(size=(0.06,) * 3), (0, 0, 0)))
    objects = [SceneObject(name="top", spec=top, environment=True)]
    objects += [
        SceneObject(name=f"cube{k}", spec=cube, xy=place, z=height + 1e-4)
        for k, place in enumerate(places)
    ]
    model = to_mjspec(SceneSpec(objects=tuple(objects))).compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, nstep=500)
    return [bool(data.body(f"cube{k}").xpos[2] < height - 0.01) for k in range(len(places))]


@pytest.mark.parametrize("size", [SLAB, TALL])
@pytest.mark.parametrize(
    ("outline", "share"),
    [(SupportOutline(), 1.0), (ROUND, np.pi / 4), (L_SHAPE, 0.75)],
    ids=["rectangle", "round", "polygon"],
)
def test_a_support_fills_its_box_and_its_outline(outline, share, size):
    spec = support(outline, size)
    low, high = bounds(spec)
    assert np.allclose(high - low, size, atol=2e-3)
    board = spec.parts[0].geoms[0].shape.volume()
    thick = SLAB[2] if size is SLAB else 0.04
    assert board == pytest.approx(share * size[0] * size[1] * thick, rel=0.01)
    assert (len(spec.parts[0].geoms) > 1) == (size is TALL)


@pytest.mark.parametrize(
    ("outline", "carried", "empty"),
    [
        (ROUND, [(0.0, 0.0), (0.3, 0.4), (-0.44, 0.0)], [(0.46, 0.66), (-0.43, -0.6)]),
        (L_SHAPE, [(0.4, 0.6), (-0.4, -0.6), (0.1, -0.1)], [(-0.4, 0.6), (-0.1, 0.1)]),
    ],
    ids=["round", "polygon"],
)
def test_corners_outside_of_an_outline_support_nothing(outline, carried, empty):
    assert falls(support(outline, TALL), carried + empty) == [False] * len(carried) + [True] * len(
        empty
    )
    square = support(SupportOutline(), TALL)
    assert falls(square, carried + empty) == [False] * (len(carried) + len(empty))


def test_a_circle_is_an_exact_cylinder():
    (geom,) = support(ROUND, (0.8, 0.8, 0.03)).parts[0].geoms
    assert geom.shape.type == "cylinder"
    assert geom.shape.primitive().size[:1] == (0.4,)


@pytest.mark.parametrize("outline", [ROUND, L_SHAPE], ids=["round", "polygon"])
def test_legs_stand_under_the_top(outline):
    feet = np.array(leg_positions(outline, 1.0, 1.4))
    assert len(feet) == (4 if outline is ROUND else 5)
    inside = -loops_distance(feet, [outline.corners() * [1.0, 1.4]])
    assert inside.min() > 0.99 * LEG_M / 2


def test_a_top_too_narrow_for_legs_is_a_block():
    arms = ((-0.5, -0.5), (0.5, -0.5), (0.5, -0.4), (-0.4, -0.4), (-0.4, 0.5), (-0.5, 0.5))
    spec = support(SupportOutline(shape="polygon", points=arms), (0.25, 0.25, 0.7))
    assert len(spec.parts[0].geoms) == 1
    assert np.allclose(bounds(spec)[1][2], 0.7)


def surfaced(shown=None, **surface) -> ObjectSpec:
    base = node_of(SupportOutline(), SLAB)
    node = base.model_copy(update={"surface": SupportSurface(**surface)})
    built = run(support_program(node, shown), ProgramOptions())
    assert built.spec is not None, built.signals
    return built.spec


def test_a_surface_gives_material_pattern_and_colours():
    veins = SurfacePattern(kind="veins", rgb=(0.5, 0.5, 0.5), step=0.3)
    (look,) = surfaced(material="stone", pattern=veins, rgb=(0.9, 0.9, 0.9)).materials
    assert look.density == MATERIALS["stone"].density
    assert look.rgba == pytest.approx((0.9, 0.9, 0.9, 1.0))
    assert look.pattern == veins
    # The photo's colour comes first, and the veins keep their contrast.
    (look,) = surfaced((0.45, 0.45, 0.6), material="stone", pattern=veins, rgb=(0.9,) * 3).materials
    assert look.rgba == pytest.approx((0.45, 0.45, 0.6, 1.0))
    assert look.pattern.rgb == pytest.approx((0.263, 0.263, 0.342), abs=2e-3)


def test_a_surface_of_glass_is_clear_and_a_plain_one_of_wood_has_no_grain():
    plain = SurfacePattern(kind="plain")
    (look,) = surfaced((0.5, 0.6, 0.6), material="glass", pattern=plain).materials
    assert look.rgba[3] == MATERIALS["glass"].rgba[3] < 1
    (look,) = surfaced(material="wood", pattern=plain).materials
    assert look.pattern == plain


def test_boards_run_along_the_declared_axis():
    boards = SurfacePattern(kind="boards", along="y", step=0.07)
    (look,) = surfaced(material="wood", pattern=boards).materials
    assert look.pattern == boards


def test_quartz_is_stone_by_its_words():
    node = node_of(SupportOutline(), SLAB).model_copy(update={"description": "white quartz"})
    assert 'like="stone"' in support_program(node)


@pytest.mark.parametrize("surface", ["white quartz with fine grey veins", "veined marble"])
def test_veins_are_drawn_where_words_name_them(surface):
    node = node_of(SupportOutline(), SLAB).model_copy(update={"description": surface})
    assert 'pattern="veins"' in support_program(node)
