"""Frames of handles lie on the shapes that a hand can take."""

import pytest

from neoworld_mjx.export.link_frames import frames
from neoworld_mjx.program.building import build
from neoworld_mjx.spec import pieces
from neoworld_mjx.spec.convex import box_around

CABINET = """
from neoworld_mjx.program.sdk import Object, box, cylinder

cabinet = Object("cabinet")
pine, steel = cabinet.material("pine"), cabinet.material("steel")
carcass = cabinet.part("carcass", material=pine)
carcass.add(box((0.5, 0.7, 0.4)), by="bottom")
door = cabinet.door(
    "door", carcass, x=0.25, y=(-0.35, 0.35), z=(0, 0.4), hinge="left", thickness=0.06,
)
front = door.anchor("front")[0]
"""
BAR = """
for k, z in enumerate((0.1, 0.3)):
    post = cylinder(0.015, 0.08)
    at = (front - 0.003, -0.25, z)
    door.add(post, at=at, rpy=(0, 1.5708, 0), by="back", material=steel{post})
door.add(cylinder(0.02, 0.3), at=(front + 0.08, -0.25, 0.05), by="bottom", material=steel{bar})
"""
NAMES = [
    {"post": "", "bar": ""},
    {"post": "", "bar": ", name='bar'"},
    {"post": ", name=f'handle_post_{k}'", "bar": ", name='handle_bar'"},
]


def door_of(text):
    """Return the cabinet, and the frame of its door's handle."""
    built = build(text)
    assert built.ok and built.spec is not None, built.signals
    (handle,) = (frame for frame in frames(built.spec) if frame.joint)
    return built.spec, handle


@pytest.mark.parametrize("names", NAMES)
def test_a_handle_frame_lies_on_the_bar_before_a_door(names):
    spec, handle = door_of(CABINET + BAR.format(**names))
    boxes = [box_around(piece, at) for _, piece, at in pieces(spec.part("door"))]
    low, high = max(boxes, key=lambda ends: ends[1][0])
    assert handle.pos == pytest.approx(((low + high) / 2).tolist(), abs=1e-6)


def test_without_a_handle_the_frame_is_at_the_free_edge_of_the_door():
    _, handle = door_of(CABINET)
    assert handle.pos[1] == pytest.approx(-0.35, abs=2e-3)


def test_a_hub_on_the_axis_is_no_handle():
    """The hub is thicker than the spout, so it reaches farthest, but no push there turns it."""
    _, handle = door_of("""
from neoworld_mjx.program.sdk import Object, box, cylinder

faucet = Object("faucet")
faucet.material("oak")
base = faucet.part("base", material="oak")
base.add(cylinder(0.03, 0.1), by="bottom")
spout = faucet.part("spout", material="oak")
spout.add(cylinder(0.022, 0.02), at=(0, 0, 0.1008), by="bottom")
spout.add(box((0.2, 0.02, 0.02)), at=(0.11, 0, 0.1008), by="bottom")
faucet.revolute("turn", base, spout, at=(0, 0, 0.1008), axis="up", range=(-0.9, 0.9))
""")
    # The object is centered, so it spans 24 cm about x = 0.
    assert handle.pos[0] == pytest.approx(0.12, abs=1e-3)
