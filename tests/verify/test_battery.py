import math

import pytest
import scenes

from neoworld_mjx.spec import Box, Sphere, recentred
from neoworld_mjx.verify import verify


def outcomes(verdict):
    return {f"{c.scenario}/{c.name}": c for c in verdict.checks}


@pytest.mark.parametrize("make", [scenes.cup, scenes.saucer, scenes.table, scenes.spoon])
def test_sound_objects_pass(make):
    verdict = verify(make())
    assert verdict.passed, [c for c in verdict.checks if c.outcome != "PASS"]
    assert len(verdict.checks) >= 8


def test_a_mass_is_reported():
    assert verify(
        scenes.single("b", (Box(size=(0.1, 0.1, 0.1)), (0, 0, 0)))
    ).mass_kg == pytest.approx(0.6)


def test_an_object_that_topples_fails_with_its_number():
    thin = scenes.single(
        "pin", (Box(size=(0.01, 0.01, 0.2)), (0, 0, 0.1)), (Sphere(radius=0.03), (0.03, 0, 0.2))
    )
    found = outcomes(verify(thin))
    assert found["free_fall/tilt"].outcome == "FAIL"
    assert found["free_fall/tilt"].value > 45
    assert found["free_fall/tilt"].threshold == 5.0


def cabinet(**change):
    spec = scenes.cabinet()
    joints = tuple(j.model_copy(update=change.get(j.name, {})) for j in spec.joints)
    return recentred(spec.model_copy(update={"joints": joints}))


def test_joints_move():
    verdict = verify(cabinet(), fixed_base=True)
    found = outcomes(verdict)
    assert found["force_perturbation/mobility:slide"].value > 0.9
    assert found["force_perturbation/mobility:hinge"].value > 0.9
    assert found["free_fall/rests"].outcome == "SKIP"


def test_a_drawer_that_runs_into_its_carcass_is_seen_although_contacts_are_filtered():
    spec = scenes.cabinet()
    parts = tuple(
        p.model_copy(
            update={"geoms": tuple(g.model_copy(update={"pos": (-0.03, 0, 0.1)}) for g in p.geoms)}
        )
        if p.name == "drawer"
        else p
        for p in spec.parts
    )
    found = outcomes(verify(spec.model_copy(update={"parts": parts}), fixed_base=True))
    assert found["static/part_depth"].outcome == "FAIL"
    # The drawer is moved 3 cm back from where it stood, less its clearance.
    assert found["static/part_depth"].value > 0.005


def test_a_stuck_joint_is_seen():
    rusty = cabinet(hinge={"stiffness": 1e4, "lower": -math.pi / 2})
    found = outcomes(verify(rusty, fixed_base=True))
    assert found["force_perturbation/mobility:hinge"].outcome == "FAIL"
