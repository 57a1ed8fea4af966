"""What is hollow stays hollow: volumes of colliders, and a ball that stays where it is dropped."""

import mujoco
import numpy as np
import pytest

from neoworld_mjx.physics.mjcf import to_mjspec
from neoworld_mjx.program.sandbox import run
from neoworld_mjx.spec import bounds, inertial

HEAD = (
    "import math\n"
    "from neoworld_mjx.program.sdk import Object, box, extrusion, hollow_box, lathe, sweep, torus, tube\n"
    "o = Object('vessel')\n"
    "p = o.part('p', material='ceramic')\n"
)
FLOOR = "p.add(box((0.2, 0.2, 0.01)), at=(0, 0, 0), by='top')\n"
# A vessel, its solid volume by formula where that is short, and where the ball is let go.
VESSELS: dict[str, tuple[str, float | None]] = {
    "cup": ("p.add(lathe([(0, 0), (0.03, 0), (0.04, 0.08)], thickness=0.004))", None),
    "straight_cup": (
        "p.add(lathe([(0, 0), (0.04, 0), (0.04, 0.08)], thickness=0.004, sectors=64))",
        np.pi * (0.04**2 * 0.08 - 0.036**2 * 0.076),
    ),
    "bowl": (
        "p.add(lathe([(0, 0), (0.03, 0), (0.07, 0.03), (0.08, 0.06)], thickness=0.004))",
        None,
    ),
    "deep_plate": ("p.add(lathe([(0, 0), (0.05, 0), (0.06, 0.02), (0.1, 0.025)], 0.004))", None),
    "oval_dish": ("p.add(lathe([(0, 0), (0.05, 0), (0.07, 0.05)], 0.004, oval=0.7))", None),
    "coarse_cup": ("p.add(lathe([(0, 0), (0.04, 0), (0.04, 0.08)], 0.004, sectors=8))", None),
    "bottle": (
        "p.add(lathe([(0, 0), (0.04, 0), (0.04, 0.06), (0.03, 0.08), (0.03, 0.1)], 0.003))",
        None,
    ),
    "ring_vase": ("p.add(lathe([(0.02, 0), (0.04, 0.01), (0.04, 0.09)], 0.004))\n" + FLOOR, None),
    "tube": ("p.add(tube(0.04, 0.004, 0.1), by='bottom')\n" + FLOOR, None),
    "thin_tube": ("p.add(tube(0.04, 0.002, 0.1, sectors=32), by='bottom')\n" + FLOOR, None),
    "tray": (
        "p.add(hollow_box((0.2, 0.12, 0.05), 0.006), by='bottom')",
        0.2 * 0.12 * 0.05 - 0.188 * 0.108 * 0.044,
    ),
    "bin": (
        "p.add(hollow_box((0.1, 0.1, 0.2), 0.004), by='bottom')",
        0.1 * 0.1 * 0.2 - 0.092 * 0.092 * 0.196,
    ),
    "pipe": (
        "p.add(hollow_box((0.1, 0.1, 0.2), 0.004, open=['+z', '-z']), by='bottom')\n" + FLOOR,
        0.1 * 0.1 * 0.2 - 0.092 * 0.092 * 0.2 + 0.2 * 0.2 * 0.01,
    ),
    "shelf": (
        "p.add(hollow_box((0.1, 0.1, 0.1), 0.004, open=['+z', '+x']), by='bottom')\n"
        "p.add(box((0.004, 0.1, 0.03)), at=(0.05, 0, 0), by='front.bottom')",
        None,
    ),
    "torus": ("p.add(torus(0.05, 0.012), by='bottom')\n" + FLOOR, None),
    "rope": (
        "p.add(sweep([(0.05 * math.cos(a / 2), 0.05 * math.sin(a / 2), 0.012) "
        "for a in range(12)], radius=0.012, closed=True))\n" + FLOOR,
        None,
    ),
    "horseshoe": ("p.add(torus(0.05, 0.015, arc=5.8), by='bottom')\n" + FLOOR, None),
    "panel": (
        "s = [(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)]\n"
        "h = [(0.3 * x, 0.3 * y) for x, y in s]\n"
        "p.add(extrusion(s, 0.03, holes=[h]), by='bottom')\n" + FLOOR,
        0.2 * 0.2 * 0.03 - 0.06 * 0.06 * 0.03 + 0.2 * 0.2 * 0.01,
    ),
    "comb": (
        "p.add(extrusion([(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (0.04, 0.1), (0.04, -0.04), "
        "(-0.04, -0.04), (-0.04, 0.1), (-0.1, 0.1)], 0.04), by='bottom')\n"
        "p.add(box((0.08, 0.02, 0.04)), at=(0, 0.09, 0), by='bottom')\n" + FLOOR,
        None,
    ),
    "round_hole": (
        "h = [(0.03 * math.cos(a * 0.3927), 0.03 * math.sin(a * 0.3927)) for a in range(16)]\n"
        "p.add(extrusion([(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)], 0.03, "
        "holes=[h]), by='bottom')\n" + FLOOR,
        None,
    ),
}
BALL_M = 0.012
INNER_M = {
    **dict.fromkeys(["ring_vase", "tube", "thin_tube"], 0.036),
    **dict.fromkeys(["pipe", "torus", "rope", "horseshoe", "comb"], 0.05),
    **dict.fromkeys(["panel", "round_hole"], 0.03),
}
"""Half width of cavities on a floor that is wider than they are."""


@pytest.mark.parametrize("name", VESSELS)
def test_a_ball_dropped_in_stays_in(name: str):
    text, _ = VESSELS[name]
    spec = run(HEAD + text).spec
    assert spec is not None
    low, high = bounds(spec)
    model = to_mjspec(spec, timestep=0.0005)
    start = [0.005, 0.003, high[2] + BALL_M + 0.005]
    ball = model.worldbody.add_body(name="ball", pos=start)
    ball.add_freejoint()
    hard = ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[BALL_M, 0, 0])
    # At MuJoCo's default softness a ball at 1 m/s sinks in deeper than such walls are thick.
    hard.solref, hard.priority = [0.002, 1.0], 1
    ball.mass, ball.explicitinertial = 0.01, True
    ball.inertia = [0.4 * 0.01 * BALL_M**2] * 3
    model.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], pos=[0, 0, 0])
    compiled = model.compile()
    data = mujoco.MjData(compiled)
    for _ in range(3000):
        mujoco.mj_step(compiled, data)
    at = data.body("ball").xpos - data.body(spec.name).xpos
    reach = INNER_M.get(name, float(min((high - low)[:2])) / 2)
    assert BALL_M * 0.9 < at[2] < high[2] + BALL_M * 0.9, "below the floor, or on the rim"
    assert np.hypot(at[0], at[1]) < reach


@pytest.mark.parametrize("name", [n for n, (_, volume) in VESSELS.items() if volume])
def test_volumes_of_colliders(name: str):
    text, volume = VESSELS[name]
    spec = run(HEAD + text).spec
    assert spec is not None and volume is not None
    found = inertial(spec, spec.parts[0]).mass / 2400
    assert found == pytest.approx(volume, rel=1e-9 if "lathe" not in text else 0.005)
