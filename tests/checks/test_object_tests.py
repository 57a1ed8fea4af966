"""The object tests on valid objects, and on objects with one fault each."""

import math

import numpy as np
import pytest

from neoworld_mjx.checks.object_tests import VERSION, run_object_tests
from neoworld_mjx.checks.verdict import Fault, Limit, format_quantity, make_check
from neoworld_mjx.config import VerifyOptions
from neoworld_mjx.spec import (
    AuthoredInertia,
    Box,
    Capsule,
    GeomSpec,
    JointSpec,
    Lathe,
    Material,
    ObjectSpec,
    PartSpec,
    Sphere,
    recentred,
)
from tests.support import scenes
from tests.support.furniture import chest, cupboard, geom


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


def test_the_verdict_reports_the_mass():
    assert verify(
        scenes.single("b", (Box(size=(0.1, 0.1, 0.1)), (0, 0, 0)))
    ).mass_kg == pytest.approx(0.6)


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


def test_joints_move_with_and_without_gravity():
    verdict = verify(cupboard(), fixed_base=True)
    assert named(verdict, "drive:hinge").value > 0.9
    assert named(verdict, "drive_loaded:hinge").value > 0.9
    assert named(verdict, "rests").outcome == "SKIP"


def test_a_drawer_out_of_its_carcass_is_not_detached():
    # At the end of its range the drawer is in the air before its carcass, as drawers are.
    verdict = verify(chest())
    assert verdict.passed, bad(verdict)
    assert named(verdict, "gap:slide").outcome == "PASS"
    assert named(verdict, "drive:slide").value > 0.9


def test_a_part_with_a_gap_to_its_parent_is_detached():
    spec = chest()
    away = tuple(
        p.model_copy(
            update={"geoms": tuple(g.model_copy(update={"pos": (0.6, 0, 0.1)}) for g in p.geoms)}
        )
        if p.name == "drawer"
        else p
        for p in spec.parts
    )
    verdict = verify(spec.model_copy(update={"parts": away}))
    assert verdict.cause is Fault.PART_DETACHED
    assert named(verdict, "gap:slide").joint == "slide"


def test_overlap_of_parent_and_child_is_detected_although_contacts_are_filtered():
    deep = tuple(
        p.model_copy(
            update={
                "geoms": tuple(g.model_copy(update={"pos": (-0.02, 0, 0.071)}) for g in p.geoms)
            }
        )
        if p.name == "drawer"
        else p
        for p in chest().parts
    )
    verdict = verify(chest().model_copy(update={"parts": deep}), fixed_base=True)
    assert verdict.cause is Fault.PARTS_OVERLAP
    assert named(verdict, "part_depth:carcass:drawer").value == pytest.approx(0.02, abs=1e-3)


def test_a_range_into_the_carcass_fails_and_its_free_part_is_measured():
    tests = run_object_tests(cupboard(lower=-0.3))
    check = named(tests.verdict, "depth:hinge")
    assert (check.outcome, check.fault) == ("FAIL", Fault.LIMIT_INTO_PART)
    assert check.at < -0.2
    low, high = tests.joint_checks.free["hinge"]
    # A door that hangs half a millimetre before its frame may swing in by 2.5 mrad, and 1 mm more.
    assert -0.01 < low <= 0.0
    assert high == pytest.approx(1.57)


def test_a_door_that_opens_into_its_carcass_collides_from_the_start():
    verdict = verify(cupboard(axis=(0, 0, -1)))
    assert named(verdict, "depth:hinge").fault is Fault.JOINT_INTO_PART


def test_joints_are_compared_with_their_declared_intent():
    intent = {"type": "revolute", "opens": (1, 0, 0), "travel": 1.2}
    assert verify(cupboard(intent=intent)).passed
    verdict = verify(cupboard(intent=intent, axis=(0, 0, -1)))
    assert verdict.cause is Fault.AXIS_REVERSED
    verdict = verify(cupboard(intent=intent, upper=0.3))
    assert verdict.cause is Fault.LIMITS_NARROW
    verdict = verify(cupboard(intent={**intent, "type": "prismatic"}))
    assert verdict.cause is Fault.JOINT_TYPE


def test_joint_damping_does_not_hide_toppling():
    spec = chest(damping=1e4, friction=100.0)
    foot = geom("foot", (0.02, 0.02, 0.1), (0.15, 0, -0.05))
    parts = tuple(
        p.model_copy(update={"geoms": (*p.geoms, foot)}) if p.name == "carcass" else p
        for p in spec.parts
    )
    verdict = verify(recentred(spec.model_copy(update={"parts": parts})))
    assert named(verdict, "balance").outcome == "FAIL"
    assert named(verdict, "tilt").outcome == "FAIL"
    # The damping makes the joint stuck.
    assert named(verdict, "drive:slide").fault is Fault.JOINT_STUCK


def test_depth_at_impact_is_not_resting_depth():
    # Dropped from 2 cm a block presses well over a millimetre into soft ground, then stands.
    options = VerifyOptions(drop_height_m=0.1)
    tests = run_object_tests(scenes.single("b", (Box(size=(0.1, 0.1, 0.1)), (0, 0, 0))), options)
    trajectory = next(t for t in tests.trajectories if t.scenario.name == "fall")
    assert trajectory.qpos[:, 2].min() < -0.001
    assert named(tests.verdict, "resting_depth:fall").value < 1e-4


def test_undamped_and_stuck_joints_fail():
    verdict = verify(cupboard(damping=0.0, friction=0.0))
    assert named(verdict, "coast:hinge").value == pytest.approx(0.0, abs=0.01)
    assert verdict.cause is Fault.JOINT_UNDAMPED
    verdict = verify(cupboard(friction=500.0))
    assert named(verdict, "drive:hinge").fault is Fault.JOINT_STUCK


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


def pear():
    """A turned fruit on its side with its axis level, where its centre of mass is not above it."""
    turn = [math.pi * k / 16 for k in range(1, 9)]
    profile = ((0.0, 0.0), *((0.027 * math.sin(t), 0.027 * (1 - math.cos(t))) for t in turn))
    profile += ((0.0265, 0.031), (0.0238, 0.04), (0.019, 0.048), (0.0, 0.054))
    fruit = GeomSpec(
        name="fruit", shape=Lathe(profile=profile, sectors=20), pos=(-0.033, 0, 0.027),
        quat=(math.sqrt(0.5), 0, math.sqrt(0.5), 0), material="skin",
    )  # fmt: skip
    skin = Material(name="skin", density=600)
    return ObjectSpec(
        name="pear", materials=(skin,), parts=(PartSpec(name="body", geoms=(fruit,)),)
    )


def test_a_round_object_may_settle_with_another_side_down():
    verdict = verify(pear())
    assert named(verdict, "tilt").value > 5.0
    assert verdict.passed, bad(verdict)
    # Beyond the tilt that composition corrects it fails, with a hint that fits.
    load = (Sphere(radius=0.01), (0.012, 0, 0.09))
    egg = scenes.single("egg", (Capsule(radius=0.02, length=0.06), (0, 0, 0.05)), load)
    tilt = named(verify(egg), "tilt")
    assert (tilt.outcome, tilt.threshold) == ("FAIL", 30.0)
    assert "widen" not in tilt.hint and "pose in which it rests" in tilt.hint


def test_a_flat_base_with_a_bump_is_not_round():
    bump = (Sphere(radius=0.004), (0, 0, 0.0))
    rocking = scenes.single("cup", (Box(size=(0.08, 0.08, 0.1)), (0, 0, 0.048)), bump)
    lean = named(verify(rocking), "tilt")
    assert lean.threshold == 5.0
    assert named(verify(chest()), "tilt").threshold == 5.0


def test_a_check_states_value_bound_direction_and_unit():
    topples = named(
        verify(scenes.single("pin", (Box(size=(0.01, 0.01, 0.2)), (0, 0, 0.1)))), "drift"
    )
    assert topples.phrase() == "drift 0 mm, at most 10.0 mm"
    assert format_quantity(8.215548565693807, "deg") == "8.2 degrees"
    least = make_check(
        "static", "covered", 0.5, Limit(0.9, "of its range", Fault.JOINT_STUCK, least=True)
    )
    assert least.phrase() == "covered 50 % of its range, at least 90 % of its range"


def test_every_part_is_pushed_in_six_directions():
    names = [run.scenario.name for run in run_object_tests(chest()).trajectories]
    for part in ("carcass", "drawer"):
        assert sum(name.startswith(f"push:{part}:") for name in names) == 6


def test_the_same_object_gets_the_same_verdict_at_any_number_of_threads():
    one, two = verify(cupboard(), threads=1), verify(cupboard(), threads=2)
    assert one.to_json() == two.to_json()


def test_an_impossible_inertia_fails_and_the_object_is_simulated_without_it():
    spec = cupboard()
    for moments in ((-1e-3, 1e-3, 1e-3), (1e-9, 1e-9, 1e-9), (1e-3, 1e-3, 1e-1)):
        spread = AuthoredInertia(pos=(0.16, 0, 0.25), moments=moments)
        parts = tuple(
            p.model_copy(update={"mass": 2.0, "inertia": spread}) if p.name == "door" else p
            for p in spec.parts
        )
        verdict = verify(spec.model_copy(update={"parts": parts}))
        assert verdict.cause is Fault.INERTIA_IMPOSSIBLE
        assert named(verdict, "drive:hinge").outcome == "PASS"
        assert np.isfinite(verdict.mass_kg)


def tap():
    """A tap whose handle turns about two axes by way of a link without geometry."""
    bead = Material(name="helper", density=400)
    spec = chest()
    block = geom("block", (0.1, 0.1, 0.1), (0, 0, 0.05))
    lever = geom("lever", (0.2, 0.02, 0.02), (0.1, 0, 0.115))
    middle = GeomSpec(name="bead", shape=Sphere(radius=0.001), pos=(0, 0, 0.1), material="helper")
    # Its authored mass and inertia cannot be compared with those of the bead.
    heavy = AuthoredInertia(pos=(0, 0, 0.1), moments=(1e-4, 1e-4, 1e-4), products=(0, 0, 0))
    turns = {"type": "revolute", "pos": (0, 0, 0.1), "upper": 1.0, "friction": 0.05, "damping": 0.2}
    return spec.model_copy(
        update={
            "materials": (*spec.materials, bead),
            "parts": (
                PartSpec(name="body", geoms=(block,)),
                PartSpec(name="link", geoms=(middle,), mass=0.05, inertia=heavy),
                PartSpec(name="handle", geoms=(lever,)),
            ),
            "joints": (
                JointSpec.model_validate(
                    {**turns, "name": "hot", "parent": "body", "child": "link", "axis": (0, 0, 1)}
                ),
                JointSpec.model_validate(
                    {
                        **turns,
                        "name": "open",
                        "parent": "link",
                        "child": "handle",
                        "axis": (0, -1, 0),
                    }
                ),
            ),
        }
    )


def test_a_link_without_geometry_is_not_compared_with_its_placeholder():
    tests = run_object_tests(tap(), fixed_base=True)
    assert tests.verdict.passed, bad(tests.verdict)
    asked = {check.name for check in tests.verdict.checks}
    assert "moments:link" in asked
    assert not asked & {"spread:link", "centre:link", "mass:link", "gap:hot"}
    # A hand pulls at the far end of all parts that a joint moves, not at the next link.
    simulation = tests.simulation
    arms = {moving.name: simulation.moment_arm(moving) for moving in simulation.joints}
    assert arms["hot"] == pytest.approx(0.2, abs=0.01)


def test_friction_does_not_drive_a_joint_that_damping_stops_within_a_step():
    stiff = cupboard(friction=1.0, damping=2.0)
    switch = PartSpec(name="door", geoms=(geom("lever", (0.02, 0.06, 0.02), (0.16, 0.17, 0.25)),))
    verdict = verify(stiff.model_copy(update={"parts": (stiff.parts[0], switch)}), fixed_base=True)
    assert named(verdict, "coast:hinge").value > 0.5
    assert not set(verdict.faults) & {Fault.LIMIT_SOFT, Fault.JOINT_UNDAMPED, Fault.RESTLESS}
