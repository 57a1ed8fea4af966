"""Words in place of numbers: named anchors, hinges at named edges, directions, mirror images."""

import numpy as np
import pytest

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program import build
from neoworld_mjx.program.building import run
from neoworld_mjx.spec import link_poses

HEAD = (
    "from neoworld_mjx.program.sdk import Object, box, cylinder, mirror\n"
    "o = Object('thing')\n"
    "body = o.part('body', material='oak')\n"
    "body.add(box((0.4, 0.4, 0.4)), by='bottom')\n"
    "p = o.part('p', material='oak')\n"
)
SIDES = {"front": 0, "back": 0, "left": 1, "right": 1, "top": 2, "bottom": 2}
OUT = {"front": 1, "back": -1, "left": 1, "right": -1, "top": 1, "bottom": -1}
CASES = [
    (face, edge)
    for face in SIDES
    for edge in SIDES
    if SIDES[face] != SIDES[edge] and face != "bottom"
]


def flap(face: str, edge: str) -> str:
    size = [0.4, 0.4, 0.4]
    size[SIDES[face]] = 0.02
    opposite = {"front": "back", "back": "front", "left": "right", "right": "left"}
    by = {**opposite, "top": "bottom", "bottom": "top"}[face]
    return HEAD + (
        f"p.add(box({tuple(size)}), at=body.anchor('{face}'), by='{by}')\n"
        f"o.revolute('j', body, p, at='{edge}.hinge', range=(0, 1.5))\n"
    )


@pytest.mark.parametrize(("face", "edge"), CASES)
def test_a_hinge_at_any_edge_of_any_face_opens_outwards(face: str, edge: str):
    built = build(flap(face, edge))
    assert built.ok and built.spec is not None, [s.phrase() for s in built.signals]
    (joint,) = built.spec.joints
    axis, out = SIDES[face], OUT[face]
    # On the named edge, on the face towards the body, and the far edge moves away.
    assert abs(joint.axis[axis]) < 1e-12 and abs(joint.axis[SIDES[edge]]) < 1e-12
    moved = link_poses(built.spec, {"j": 0.1})["p"]
    low, high = np.array([-0.2, -0.2, 0]), np.array([0.2, 0.2, 0.4])
    shift = low[2] * 0 + (0.02 if face == "bottom" else 0)
    middle = (low + high) / 2 + [0, 0, shift]
    assert out * (moved.apply(middle) - middle)[axis] > 0.01
    hinge = np.array(joint.pos)
    assert np.allclose(moved.apply(hinge), hinge, atol=1e-9)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("o.revolute('j', body, p, at='front.hinge', range=(0, 1))", "one edge of a flat part"),
        ("o.revolute('j', body, p, at='hinge', range=(0, 1))", "one edge of a flat part"),
        ("o.revolute('j', body, p, at='left.top.hinge', range=(0, 1))", "one edge of a flat part"),
        ("o.revolute('j', body, p, at='lft.hinge', range=(0, 1))", "got 'lft'"),
        ("o.revolute('j', body, p, at='left', range=(0, 1))", "needs axis="),
        ("o.revolute('j', body, p, at='left', axis='upwards', range=(0, 1))", "one of front"),
        ("mirror((0, 0, 0), 'w')", "across"),
        ("mirror([])", "1 to 1000"),
        ("mirror([(0, 0)])", "3 entries"),
    ],
)
def test_unknown_words_are_refused_with_the_valid_choices(line: str, words: str):
    text = HEAD + "p.add(box((0.02, 0.4, 0.4)), at=body.anchor('front'), by='back')\n" + line
    (signal,) = run(text, ProgramOptions(type_check=False)).signals
    assert signal.code == "value" and words in signal.message and signal.line == 7
