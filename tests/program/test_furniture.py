import numpy as np
import pytest

from neoworld_mjx.program import build
from neoworld_mjx.spec import bounds, link_poses

HEAD = (
    "from neoworld_mjx.program.sdk import Object, box, grid, hollow_box, ring\n"
    "o = Object('cabinet')\n"
    "body = o.part('body', material='oak')\n"
    "body.add(hollow_box((0.4, 0.6, 0.6), 0.02, open='+x'), by='bottom')\n"
)


@pytest.mark.parametrize("hinge", ["left", "right", "top", "bottom"])
def test_doors_open_outwards_on_every_edge(hinge: str):
    text = HEAD + f"o.door('d', body, x=0.2, y=(-0.3, 0.3), z=(0, 0.6), hinge='{hinge}')\n"
    built = build(text)
    assert built.spec is not None and built.signals == ()
    low, high = bounds(built.spec)
    opened_low, opened_high = bounds(built.spec, {"d_hinge": 1.4})
    assert opened_high[0] > high[0] + 0.5 and opened_low[0] >= low[0] - 1e-9


@pytest.mark.parametrize("overlay", [0, 0.015])
def test_drawers_move_without_contact(overlay: float):
    text = HEAD + (
        f"d = o.drawer('d', body, x=0.2, y=(-0.28, 0.28), z=(0.02, 0.58), depth=0.35, "
        f"overlay={overlay})\n"
    )
    built = build(text)
    assert built.spec is not None and built.signals == ()
    (joint,) = built.spec.joints
    assert joint.type == "prismatic" and joint.upper == pytest.approx(0.75 * 0.35)
    moved = link_poses(built.spec, {"d_slide": 0.1})["d"]
    assert np.allclose(moved.pos, [0.1, 0, 0])


@pytest.mark.parametrize(
    "call",
    [
        "o.door('d', body, x=0, y=(1, 0), z=(0, 1), hinge='left')",
        "o.door('d', body, x=0, y=(0, 1), z=(0, 1), hinge='front')",
        "o.door('d', body, x=0, y=(0, 0.1), z=(0, 1), hinge='left', gap=0.06)",
        "o.drawer('d', body, x=0, y=(0, 0.01), z=(0, 1), depth=0.3, wall=0.01)",
        "o.shelf(body, x=(0, 1), y=(1, 0), z=0)",
        "bail(0.1, 0, 0.01)",
        "panel((0.1, 0.1), 0.01, holes=[(0.06, 0, 0.02)])",
        "panel((0.1, 0.1), 0.01, holes=[(0, 0)])",
        "grid((1000, 1000), (1, 1))",
        "ring(0, 1)",
    ],
)
def test_wrong_furniture_is_refused(call: str):
    from neoworld_mjx.config import ProgramOptions

    head = HEAD.replace("grid,", "bail, panel, grid,")
    (signal,) = build(head + call, ProgramOptions(type_check=False)).signals
    assert signal.code == "value"


OVERLAP = HEAD + (
    "d = o.part('d', material='oak')\n"
    "d.add(box((0.02, 0.6, 0.6)), at=(0.207, 0, 0.3))\n"
    "o.prismatic('s', body, d, axis=(1, 0, 0), range=(0, 0.1))\n"
)


def test_an_allowance_is_applied_and_reported():
    assert {s.code for s in build(OVERLAP).signals} == {"overlap_at_rest"}
    granted = build(OVERLAP + "o.allow_overlap(body, d, 0.004, 'the rebate of the lid')")
    assert granted.ok
    assert [(s.code, s.severity) for s in granted.signals] == [("allowed_overlap", "warning")]
    assert "rebate" in granted.signals[0].message
