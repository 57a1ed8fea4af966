"""Programs of supports: they fill their outline, and only there they carry."""

import numpy as np
import pytest

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program.building import run
from neoworld_mjx.program.supports import MATERIALS, support_program
from neoworld_mjx.spec import (
    Box2D,
    Box3D,
    ObjectSpec,
    SupportOutline,
    SupportSurface,
    SurfacePattern,
    TreeNode,
    bounds,
)

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
