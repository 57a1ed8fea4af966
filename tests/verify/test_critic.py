"""The critic sees labelled strips; the reasoner's edits are kept only where they help."""

import pytest

from neoworld_mjx.config import VerifyOptions
from neoworld_mjx.errors import MissingAnswerError, ModelError
from neoworld_mjx.mllm import Panel
from neoworld_mjx.verify import Battery, Patch, Repaired, verify_and_repair
from neoworld_mjx.verify.critic import (
    Finding,
    MotionCritique,
    ProposedEdit,
    edit_request,
    key_frames_request,
    with_models,
)
from neoworld_mjx.verify.key_frames import questionable, strips
from neoworld_mjx.verify.verdict import Fault, Limit, judged
from tests.support import furniture as objects
from tests.support.scripted_model import ScriptedModel

BAD = objects.cupboard(lower=-0.4)
MENDS = Patch.model_validate({"joints": {"hinge": {"lower": 0.0}}})
HARMS = Patch.model_validate({"joints": {"hinge": {"lower": -0.6}}})
FOUND = MotionCritique(findings=[Finding(where="door", what="swings in")], verdict="edit")


def tried(*answers):
    battery = Battery(BAD)
    made = Repaired(BAD, Patch(), battery.verdict, battery.verdict)
    script = ScriptedModel(*answers)
    with Panel(script) as models:
        told = with_models(made, battery, models, Battery, BAD)
    return made, told, script


def test_strips_show_what_failed_with_labels():
    battery = Battery(BAD)
    found = strips(battery)
    assert 1 <= len(found) <= 3
    assert found[0].label == "joint_range depth:hinge"
    assert found[0].size == (880, 216)
    # The same object gives the same key on every machine; another one gives another.
    assert found[0].pixels == strips(Battery(BAD))[0].pixels
    assert found[0].pixels != strips(Battery(objects.cupboard(lower=-0.5)))[0].pixels


def test_nothing_doubtful_is_nothing_to_see():
    battery = Battery(objects.cupboard())
    assert questionable(battery.verdict) == []
    assert "- none" in key_frames_request(battery).prompt
    assert strips(battery) == []


def test_requests_tell_the_numbers_and_what_may_be_edited():
    battery = Battery(BAD)
    request = key_frames_request(battery)
    assert request.role == "critic"
    assert "FAIL joint_range depth:hinge" in request.prompt
    asked = edit_request(battery, FOUND)
    assert asked.role == "reasoner"
    assert "swings in" in asked.prompt
    assert "joint hinge: revolute, door on carcass" in asked.prompt


def only_just():
    """A cupboard whose door reaches 0.9 mm into its carcass, where a millimetre is let pass."""
    return objects.cupboard(lower=-0.0035)


def test_what_only_just_passes_is_doubtful_and_shown():
    battery = Battery(only_just())
    assert battery.verdict.passed
    (check,) = battery.verdict.doubtful
    assert (check.name, check.outcome, check.fault) == ("depth:hinge", "PASS", None)
    assert 0.8e-3 <= check.value <= 1e-3
    assert "ONLY JUST PASSED joint_range depth:hinge" in key_frames_request(battery).prompt
    assert [strip.label for strip in strips(battery)] == ["joint_range depth:hinge"]
    assert strips(battery)[0].shows.count("hinge") > 4  # Drawn with the door where it is worst.


@pytest.mark.parametrize(
    ("value", "limit", "doubt"),
    [
        (0.79, {"threshold": 1.0}, False),
        (0.81, {"threshold": 1.0}, True),
        (1.0, {"threshold": 1.0}, True),
        (1.01, {"threshold": 1.0}, False),  # It fails: there is no doubt about it.
        (1.21, {"threshold": 1.0, "least": True}, False),
        (1.19, {"threshold": 1.0, "least": True}, True),
        (0.99, {"threshold": 0.9, "least": True, "best": 1.0}, False),
        (0.91, {"threshold": 0.9, "least": True, "best": 1.0}, True),
        (0.01, {"threshold": 0.0, "least": True, "best": 0.1}, True),
        (0.03, {"threshold": 0.0, "least": True, "best": 0.1}, False),
        (0.0, {"threshold": 0.0}, False),
        (float("nan"), {"threshold": 1.0}, False),
    ],
)
def test_a_number_is_doubtful_near_its_threshold(value, limit, doubt):
    found = judged("static", "x", value, Limit(unit="m", fault=Fault.PARTS_OVERLAP, **limit))
    assert found.doubtful is doubt


def test_the_critic_sees_what_is_doubtful_and_no_edit_is_asked_for():
    script = ScriptedModel(FOUND)
    result = verify_and_repair(only_just(), models=Panel(script))
    assert [request.role for request in script.requests] == ["critic"]
    assert result.seen == ("door: swings in",)
    assert result.verdict.passed
    assert result.patch.empty
    script = ScriptedModel()
    verify_and_repair(objects.cupboard(), models=Panel(script))
    assert script.requests == []  # Nothing in doubt: nobody is asked.


def test_an_opinion_changes_no_outcome():
    flipped = objects.cupboard(axis=(0, 0, -1))
    sound = verify_and_repair(flipped, models=Panel(ScriptedModel(MotionCritique(verdict="sound"))))
    assert not sound.verdict.passed
    assert sound.verdict == Battery(flipped).verdict
    bad = verify_and_repair(
        only_just(), models=Panel(ScriptedModel(MotionCritique(verdict="reprogram")))
    )
    assert bad.verdict == Battery(only_just()).verdict


def test_without_rounds_the_critic_looks_and_nothing_is_edited():
    script = ScriptedModel(FOUND)
    result = verify_and_repair(BAD, VerifyOptions(rounds=0), models=Panel(script))
    assert (len(script.requests), result.seen) == (1, ("door: swings in",))
    assert result.patch.empty
    assert not result.verdict.passed


def test_an_edit_that_helps_is_kept():
    made, told, _ = tried(FOUND, ProposedEdit(patch=MENDS))
    assert made.after.passed
    assert made.patch == MENDS
    assert [seen.verdict for seen in told] == ["edit"]


@pytest.mark.parametrize(
    "patch", [HARMS, Patch.model_validate({"parts": {"door": {"mass": 900.0}}})]
)
def test_an_edit_that_does_not_help_is_dropped_and_listed(patch):
    made, _, _ = tried(FOUND, ProposedEdit(patch=patch))
    assert made.patch.empty
    assert made.after == made.before
    assert len(made.tried) == 1


def test_what_must_be_programmed_anew_is_not_edited():
    made, told, script = tried(MotionCritique(verdict="reprogram"))
    assert (made.patch.empty, len(told), len(script.requests)) == (True, 1, 1)


def test_a_server_that_fails_costs_the_edit_not_the_run():
    made, told, _ = tried(ModelError("gone"))
    assert told == []
    assert "was not answered: gone" in made.tried[0]
    with pytest.raises(MissingAnswerError):
        tried(MissingAnswerError("the tape has none"))


def test_numbers_come_first():
    script = ScriptedModel()
    result = verify_and_repair(BAD, models=Panel(script))
    assert result.verdict.passed  # Cut by direct repair: nobody was asked.
    assert script.requests == []
    flipped = objects.cupboard(axis=(0, 0, -1))
    script = ScriptedModel(MotionCritique(findings=FOUND.findings, verdict="reprogram"))
    result = verify_and_repair(flipped, models=Panel(script))
    assert not result.verdict.passed
    assert result.seen == ("door: swings in",)
