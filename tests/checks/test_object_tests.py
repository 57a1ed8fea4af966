"""The object tests on valid objects, and on objects with one fault each."""

import math
import re

import pytest

from neoworld_mjx.checks import joint_checks, scenarios
from neoworld_mjx.checks.object_tests import VERSION, run_object_tests
from neoworld_mjx.checks.verdict import BUDGET, Fault
from neoworld_mjx.config import VerifyOptions
from neoworld_mjx.spec import Box, Cylinder, JointSpec, ObjectSpec, Sphere
from tests.support import scenes
from tests.support.furniture import chest, cupboard
from tests.support.mechanisms import WOOD, geom, part


def verify(spec, **how):
    return run_object_tests(spec, **how).verdict


def named(verdict, name):
    return next(check for check in verdict.checks if check.name == name)


def bad(verdict):
    return [(c.name, c.value, c.threshold) for c in verdict.checks if c.outcome == "FAIL"]


@pytest.mark.parametrize(
    "make", [scenes.cup, scenes.saucer, scenes.table, scenes.spoon, cupboard, chest]
)
def test_valid_objects_pass(make):
    verdict = verify(make())
    assert verdict.passed, bad(verdict)
    assert verdict.faults == ()
    assert verdict.score == 0.0
    assert verdict.battery == VERSION
    assert len(verdict.checks) >= 20


def test_an_object_that_topples_fails_with_its_number():
    thin = scenes.single(
        "pin", (Box(size=(0.01, 0.01, 0.2)), (0, 0, 0.1)), (Sphere(radius=0.03), (0.03, 0, 0.2))
    )
    verdict = verify(thin)
    tilt = named(verdict, "tilt")
    assert (tilt.outcome, tilt.fault, tilt.threshold) == ("FAIL", Fault.TOPPLES, 5.0)
    assert tilt.value > 45
    assert tilt.time > 0
    # The cause stands before the symptom: its weight falls beside its foot.
    assert verdict.cause is Fault.OFF_BALANCE
    assert named(verdict, "balance").value < 0


def test_a_range_into_the_carcass_fails_and_its_free_part_is_measured():
    tests = run_object_tests(cupboard(lower=-0.3))
    check = named(tests.verdict, "depth:hinge")
    assert (check.outcome, check.fault) == ("FAIL", Fault.LIMIT_INTO_PART)
    assert check.at < -0.2
    low, high = tests.joint_checks.free["hinge"]
    # A door that hangs half a millimetre before its frame may swing in by 2.5 mrad, and 1 mm more.
    assert -0.01 < low <= 0.0
    assert high == pytest.approx(1.57)


def test_joints_are_compared_with_their_declared_intent():
    intent = {"type": "revolute", "opens": (1, 0, 0), "travel": 1.2}
    assert verify(cupboard(intent=intent)).passed
    verdict = verify(cupboard(intent=intent, axis=(0, 0, -1)))
    assert verdict.cause is Fault.AXIS_REVERSED
    verdict = verify(cupboard(intent=intent, upper=0.3))
    assert verdict.cause is Fault.LIMITS_NARROW
    verdict = verify(cupboard(intent={**intent, "type": "prismatic"}))
    assert verdict.cause is Fault.JOINT_TYPE


def test_depth_at_impact_is_not_resting_depth(monkeypatch):
    # Dropped from 2 cm a block presses well over a millimetre into soft ground, then stands.
    monkeypatch.setattr(scenarios, "DROP_HEIGHT_M", 0.1)
    tests = run_object_tests(scenes.block("b", (0.1, 0.1, 0.1)))
    trajectory = next(t for t in tests.trajectories if t.scenario.name == "fall")
    assert trajectory.qpos[:, 2].min() < -0.001
    assert named(tests.verdict, "resting_depth:fall").value < 1e-4


def test_an_error_inside_a_check_does_not_pass(monkeypatch):
    from neoworld_mjx.checks import object_tests

    def fails(*_):
        raise ValueError("no such thing")

    monkeypatch.setattr(object_tests, "check_joints", fails)
    verdict = verify(scenes.cup())
    assert not verdict.passed
    assert [c.hint for c in verdict.checks if c.outcome == "TOOL_FAILURE"] == ["no such thing"]
    assert verdict.score >= 1.0


def test_a_lying_object_is_dropped_in_its_resting_orientation():
    pole = scenes.single("pole", (Box(size=(0.02, 0.03, 0.5)), (0, 0, 0.25)))
    assert verify(pole).cause is not None
    half = math.sqrt(0.5)
    lying = verify(pole, tilt=(half, 0, half, 0))
    assert lying.passed, bad(lying)


@pytest.mark.parametrize(("radius", "height"), [(0.0425, 0.036), (0.03, 0.1), (0.2, 0.02)])
def test_cylinders_pass_upright_and_on_their_side(radius, height):
    cylinder = scenes.single("can", (Cylinder(radius=radius, height=height), (0, 0, height / 2)))
    for threads in (1, 2):
        upright = verify(cylinder, threads=threads)
        assert upright.passed, bad(upright)
    # On its side, about a diagonal, a cylinder touches the floor between the points of a facet.
    half, heading = math.sqrt(0.5), math.radians(7.5)
    tilt = (half, half * math.cos(heading), half * math.sin(heading), 0.0)
    lying = verify(cylinder, tilt=tilt)
    assert not [check for check in lying.checks if check.outcome == "TOOL_FAILURE"]


def test_a_ball_that_rolls_when_tilted_has_no_fault():
    # A dent that is slightly off its middle keeps it moving, as it does an orange.
    dent = (Sphere(radius=0.004), (0.039, 0, 0))
    ball = scenes.single("ball", (Sphere(radius=0.04), (0, 0, 0)), dent)
    verdict = verify(ball)
    names = {check.name for check in verdict.checks}
    assert Fault.RESTLESS not in verdict.faults
    assert "resting_speed:fall" in names
    assert "resting_speed:fall_tilted_x" not in names
    assert named(verdict, "fall_tilted_x").outcome == "SKIP"


def chain(count):
    """Boxes in a row, each hinged to the one before."""
    names = [f"p{k}" for k in range(count + 1)]
    links = tuple(
        part(name, geom(f"g{k}", Box(size=(0.02, 0.02, 0.02)), (0.021 * k, 0, 0.01)))
        for k, name in enumerate(names)
    )
    hinges = tuple(
        JointSpec(
            name=f"j{k}", type="revolute", parent=names[k - 1], child=names[k],
            pos=(0.021 * k - 0.01, 0, 0.01), axis=(0, 1, 0), lower=-0.1, upper=0.1, damping=1e-4,
        )
        for k in range(1, count + 1)
    )  # fmt: skip
    return ObjectSpec(name="chain", materials=(WOOD,), parts=links, joints=hinges)


def test_the_work_of_scenarios_is_bounded_and_what_is_left_out_is_told(monkeypatch):
    """Without a bound, the time of the tests grows with the square of the number of joints."""
    options = VerifyOptions(duration_s=0.5)
    monkeypatch.setattr(scenarios, "MOST_S", 0.3)
    left_out, runs = {}, {}
    for count in (2, 8, 16, 60):
        result = run_object_tests(chain(count), options)
        kinds = [trajectory.scenario.kind for trajectory in result.trajectories]
        runs[count] = len(kinds)
        assert kinds.count("free_fall") == (3 if count < 60 else 1)
        hints = [check.hint for check in result.verdict.checks if check.name == BUDGET]
        left_out[count] = int(hints[0].split()[0]) if hints else 0
    assert left_out[2] == 0 and runs[2] == 35
    assert 0 < left_out[8] < left_out[16] < left_out[60] == 121
    assert runs[2] > runs[8] > runs[16] > runs[60] == 1
    assert re.match(r"121 parts and joints are neither pushed nor moved.*p0, p1, p2", hints[0])


def test_a_joint_sweep_that_takes_too_long_is_a_failure_that_says_so(monkeypatch):
    monkeypatch.setattr(joint_checks, "SWEEP_S", 0.0)
    verdict = verify(chain(2))
    (check,) = [check for check in verdict.checks if check.outcome == "TOOL_FAILURE"]
    assert not verdict.passed and "of processor time; use fewer" in check.hint
