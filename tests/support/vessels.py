"""Vessels, whose colliders must be hollow: a ball that is dropped into one stays in it."""

import mujoco
import numpy as np

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.physics.mjcf import to_mjspec
from neoworld_mjx.program.building import run
from neoworld_mjx.spec import ObjectSpec, bounds
from neoworld_mjx.spec.convex import mass_properties

_HEAD = (
    "import math\n"
    "from neoworld_mjx.program.sdk import Object, box, cylinder, difference, extrusion, hollow_box\n"
    "from neoworld_mjx.program.sdk import intersection, lathe, sphere, sweep, torus, tube, union\n"
    "o = Object('vessel')\n"
    "p = o.part('p', material='ceramic')\n"
)
_FLOOR = "p.add(box((0.2, 0.2, 0.01)), at=(0, 0, 0), by='top')\n"
VESSELS: dict[str, str] = {
    "cup": ("p.add(lathe([(0, 0), (0.03, 0), (0.04, 0.08)], thickness=0.004))\n"),
    "bowl": ("p.add(lathe([(0, 0), (0.03, 0), (0.07, 0.03), (0.08, 0.06)], thickness=0.004))\n"),
    "bottle": (
        "p.add(lathe([(0, 0), (0.04, 0), (0.04, 0.06), (0.03, 0.08), (0.03, 0.1)], 0.003))\n"
    ),
    "tube": ("p.add(tube(0.04, 0.004, 0.1), by='bottom')\n") + _FLOOR,
    "tray": ("p.add(hollow_box((0.2, 0.12, 0.05), 0.006), by='bottom')\n"),
    "pipe": ("p.add(hollow_box((0.1, 0.1, 0.2), 0.004, open=['+z', '-z']), by='bottom')\n")
    + _FLOOR,
    "torus": ("p.add(torus(0.05, 0.012), by='bottom')\n") + _FLOOR,
    "panel": (
        "s = [(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)]\n"
        "h = [(0.3 * x, 0.3 * y) for x, y in s]\n"
        "p.add(extrusion(s, 0.03, holes=[h]), by='bottom')\n"
    )
    + _FLOOR,
    "pocket": (
        "p.add(difference(box((0.2, 0.2, 0.06)), box((0.1, 0.12, 0.06)).moved((0, 0, 0.01))), by='bottom')\n"
    ),
    "hollowed_ball": (
        "half = intersection(sphere(0.06), box((0.2, 0.2, 0.06)).moved((0, 0, -0.03)))\n"
        "p.add(difference(half, sphere(0.05)), by='bottom')\n"
        "p.add(box((0.02, 0.02, 0.002)), by='top')\n"
    ),
    "cross_of_pipes": (
        "bar = union(box((0.2, 0.1, 0.08)), box((0.1, 0.2, 0.08)))\n"
        "p.add(difference(bar, union(box((0.18, 0.08, 0.08)), box((0.08, 0.18, 0.08))).moved((0, 0, 0.01))), by='bottom')\n"
    ),
    "mortar": (
        "p.add(difference(cylinder(0.05, 0.07), sphere(0.04).moved((0, 0, 0.035))), by='bottom')\n"
    ),
}
"""Bodies of programs, each of one part that a ball can fall into."""
BALL_M = 0.012
INNER_M = {"tube": 0.036, "pipe": 0.05, "torus": 0.05, "panel": 0.03, "pocket": 0.06}
INNER_M |= {"cross_of_pipes": 0.09, "mortar": 0.04}
"""Half width of cavities that are narrower than their vessel."""


RECTANGULAR = ("tray",)
"""Vessels into whose corners the ball may roll."""


def vessel(name: str) -> ObjectSpec:
    """Build one of `VESSELS`."""
    # Run-time type checks of the tests slow the SDK down.
    built = run(_HEAD + VESSELS[name], ProgramOptions(timeout_s=10.0))
    assert built.spec is not None, built.signals
    return built.spec


def fullness(name: str) -> float:
    """Volume of the colliders over that of the shapes; where two shapes overlap, both count."""
    shapes = [geom.shape for geom in vessel(name).parts[0].geoms]
    pieces = [piece for shape in shapes for piece in shape.pieces()]
    return sum(mass_properties(p)[0] for p in pieces) / sum(shape.volume() for shape in shapes)


def holds(name: str) -> bool:
    """Return True if a ball of 12 mm radius, dropped from above, lies in the cavity after 1.5 s."""
    spec = vessel(name)
    low, high = bounds(spec)
    model = to_mjspec(spec, timestep=0.0005)
    start = [0.005, 0.003, high[2] + BALL_M + 0.005]
    ball = model.worldbody.add_body(name="ball", pos=start)
    ball.add_freejoint()
    hard = ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[BALL_M, 0, 0])
    # In MuJoCo's default soft contacts a ball at 1 m/s would pass through such thin walls.
    hard.solref, hard.priority = [0.002, 1.0], 1
    ball.mass, ball.explicitinertial = 0.01, True
    ball.inertia = [0.4 * 0.01 * BALL_M**2] * 3
    model.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], pos=[0, 0, 0])
    compiled = model.compile()
    data = mujoco.MjData(compiled)
    for _ in range(3000):
        mujoco.mj_step(compiled, data)
    at = data.body("ball").xpos - data.body(spec.name).xpos
    half = (high - low)[:2] / 2
    inside = np.hypot(at[0], at[1]) < INNER_M.get(name, float(half.min()))
    if name in RECTANGULAR:
        inside = bool(np.all(np.abs(at[:2]) < half))
    # Neither below the floor nor on the rim.
    return bool(0.9 * BALL_M < at[2] < high[2] + 0.9 * BALL_M and inside)
