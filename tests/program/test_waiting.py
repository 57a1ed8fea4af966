"""What a joint is for: what must be open before it moves, and which way it opens."""

import numpy as np
import pytest

from neoworld_mjx.checks.object_tests import run_object_tests
from neoworld_mjx.program import build
from neoworld_mjx.spec import ObjectSpec
from neoworld_mjx.spec.opening import prerequisite_state

OVEN = """
from neoworld_mjx.program.sdk import Object, box, hollow_box
o = Object("oven")
body = o.part("body", material="insulated")
shell = body.add(hollow_box((0.5, 0.6, 0.5), 0.04, open="+x"), by="bottom")
x = shell.anchor("front")[0]
flap = o.door("flap", body, x=x, y=(-0.3, 0.3), z=(0, 0.5), hinge="{hinge}", opens={opens})
for side in (-1, 1):
    body.add(box((0.4, 0.02, 0.01)), at=(0, side * 0.25, 0.3))
tray = o.part("tray", material="steel")
tray.add(hollow_box((0.4, {wide}, 0.03), 0.002), at=(x - {back}, 0, 0.3055), by="front.bottom")
slide = o.prismatic("slide", body, tray, axis="front", range=({low}, 0.25){after})
"""
GIVEN = {
    "hinge": "bottom",
    "opens": "1.5",
    "wide": "0.516",
    "back": "0.01",
    "low": "0",
    "after": ", after=flap",
}


def oven(**changes: str) -> str:
    return OVEN.format(**{**GIVEN, **changes})


def told(text: str) -> dict[str, str]:
    return {signal.code: signal.message for signal in build(text).signals}


def spec_of(text: str) -> ObjectSpec:
    built = build(text)
    assert built.spec is not None and built.signals == (), [s.phrase() for s in built.signals]
    return built.spec


@pytest.mark.parametrize("given", ["flap", "[flap]", "(flap, flap)"])
def test_a_tray_slides_out_once_its_flap_is_open(given: str):
    assert "drives 'tray' into 'flap'" in told(oven(after=""))["overlap_in_motion"]
    text = oven(after=f", after={given}")
    spec = spec_of(text)
    joint = spec.joints[1]
    assert joint.after == ("flap_hinge",)
    assert prerequisite_state(spec, joint) == {"flap_hinge": 1.5}
    assert ObjectSpec.model_validate_json(spec.to_json()) == spec


@pytest.mark.parametrize("hinge", ["bottom", "top", "left"])
def test_object_tests_drive_the_tray_with_its_flap_open(hinge: str):
    spec = spec_of(oven(hinge=hinge, opens="1.57" if hinge == "left" else "1.5"))
    tests = run_object_tests(spec)
    assert tests.verdict.passed, [c for c in tests.verdict.checks if c.outcome == "FAIL"]
    assert tests.simulation is not None
    flap, tray = (tests.simulation.address(name)[0] for name in ("flap_hinge", "slide"))
    seen = 0
    for trajectory in tests.trajectories:
        if trajectory.scenario.joint == "slide":
            seen += 1
            # A flap hung above would fall on the tray, were it not held.
            assert np.abs(trajectory.qpos[:, flap] - spec.joints[0].upper).max() < 1e-3
        if trajectory.scenario.joint == "flap_hinge":
            assert abs(trajectory.qpos[0, tray]) < 1e-9
    assert seen == 7


LID = """
from neoworld_mjx.program.sdk import Object, box, cylinder
o = Object("chest")
body = o.part("body", material="oak")
body.add(box((0.3, 0.4, 0.2)), by="bottom")
lid = o.part("lid", material="oak")
lid.add(box((0.3, 0.4, 0.02)), at=body.anchor("top"), by="bottom")
o.revolute("hinge", body, lid, at={at}, axis={axis}, range={range}, opens={opens})
"""


@pytest.mark.parametrize(
    ("changes", "codes"),
    [
        ({}, set()),
        ({"opens": "'top'"}, set()),
        ({"opens": "(0, 0, 2)"}, set()),
        ({"opens": "'down'"}, {"opens_wrong_way"}),
        ({"opens": "'left'"}, {"opens_wrong_way"}),
        # Turned the wrong way it goes through the chest as well.
        ({"axis": "(0, 1, 0)"}, {"opens_wrong_way", "overlap_in_motion"}),
        ({"axis": "(0, 1, 0)", "range": "(-1, 0)"}, {"opens_wrong_way"}),
        ({"at": "'centre'", "axis": "'up'"}, {"opens_no_way"}),
        ({"opens": "'upwards'"}, {"value"}),
    ],
)
def test_the_opening_direction_is_compared_with_the_axis(changes: dict[str, str], codes: set[str]):
    given = {"at": "'back.hinge'", "axis": "None", "range": "(0, 1)", "opens": "'up'"} | changes
    assert set(told(LID.format(**given))) == codes
