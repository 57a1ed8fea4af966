"""Step 2's compile checks and Step 3's object tests agree on the same joint sweep."""

from functools import partial
from pathlib import Path

import pytest

from neoworld_mjx.checks.joint_checks import check_joints
from neoworld_mjx.checks.joint_sweep import overlap_signals, sweep_combinations, sweep_joints
from neoworld_mjx.checks.static_checks import Probe
from neoworld_mjx.config import ProgramOptions, VerifyOptions
from neoworld_mjx.program.building import run
from neoworld_mjx.spec import Box, ObjectSpec
from neoworld_mjx.spec.kinematics import with_joint
from tests.support.mechanisms import WOOD, geom, part
from tests.support.mechanisms import joint as joint_of
from tests.support.valid_objects import valid_object

EXAMPLES = sorted((Path(__file__).parents[2] / "examples" / "objects").glob("*.py"))


def depth_of_step_2(spec, allowances=()):
    signals = overlap_signals(Probe(spec), ProgramOptions(), allowances)
    return max((signal.value for signal in signals), default=0.0)


def depth_of_step_3(spec, allowances=()):
    checks = check_joints(spec, VerifyOptions(), allowances).checks
    deep = [c for c in checks if c.outcome == "FAIL" and "depth" in c.name]
    return max((check.value for check in deep), default=0.0)


def limited(spec, **limits):
    return with_joint(spec, spec.joints[0].model_copy(update=limits))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_pass_both(path):
    built = run(path.read_text(encoding="utf-8"))
    assert built.spec is not None
    assert depth_of_step_2(built.spec, built.allowances) == 0.0
    assert depth_of_step_3(built.spec, built.allowances) == 0.0


@pytest.mark.parametrize("family", ["cabinet", "chest", "box", "lever", "oven", "button"])
@pytest.mark.parametrize("share", [0.0, -0.004, -0.3])
def test_both_steps_agree_on_generated_objects_with_limits_past_rest(family, share):
    spec = valid_object(family)
    joint = spec.joints[0]
    spec = limited(spec, lower=joint.lower + share * (joint.upper - joint.lower))
    one, other = depth_of_step_2(spec), depth_of_step_3(spec)
    assert one == other
    assert (one == 0.0) if share == 0.0 else True


def test_gaps_are_measured_at_rest_after_the_sweep():
    spec = valid_object("chest")
    pushed = limited(spec, lower=-0.2)
    gap = [
        next(c.value for c in check_joints(each, VerifyOptions()).checks if c.name[:4] == "gap:")
        for each in (spec, pushed)
    ]
    assert gap[0] == gap[1] > 0.0


def test_a_prerequisite_is_also_moved_while_the_joint_that_waits_for_it_is_closed():
    """The door hits the lid only half open, where it is only while the rack is closed.

    No position of the sweep of the rack itself is closed.
    """
    base = part("base", geom("base", Box(size=(0.02, 0.02, 0.02)), (0, 0, -0.5)))
    door = part("door", geom("door", Box(size=(0.02, 0.02, 0.02))))
    lid = part("lid", geom("lid", Box(size=(0.14, 0.1, 0.02)), (0.1, 0.08, 0)))
    rack = part("rack", geom("rack", Box(size=(0.02, 0.02, 0.02)), (0, 0, 0.5)))
    slide = partial(joint_of, kind="prismatic", parent="base")
    spec = ObjectSpec(
        name="o",
        materials=(WOOD,),
        parts=(base, door, lid, rack),
        joints=(
            slide("opens", child="door", axis=(1, 0, 0), upper=0.2),
            slide("lifts", child="lid", axis=(0, -1, 0), upper=0.1),
            slide("pulls", child="rack", axis=(0, 0, 1), lower=0.01, upper=0.1, after=("opens",)),
        ),
    )
    sweep = sweep_joints(Probe(spec), ProgramOptions())
    assert not sweep.colliding
    (pair,) = sweep_combinations(sweep)
    assert {spec.parts[k].name for k in pair} == {"door", "lid"}
