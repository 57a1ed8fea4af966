"""The critic sees labelled strips; the reasoner's edits are accepted only if they help."""

import numpy as np
import pytest

from neoworld_mjx.checks.object_tests import ObjectTests, run_object_tests
from neoworld_mjx.checks.verdict import Fault, Limit, make_check
from neoworld_mjx.config import ProgramOptions, VerifyOptions
from neoworld_mjx.errors import MissingResponseError
from neoworld_mjx.mllm import Panel, Picture
from neoworld_mjx.mllm.panel import run_coroutine
from neoworld_mjx.program.ask import SynthesisResult
from neoworld_mjx.program.critique import Subject
from neoworld_mjx.program.synthesise import ProgramSource
from neoworld_mjx.spec import Box, GeomSpec, Material, ObjectSpec, PartSpec
from neoworld_mjx.verify import Patch, verification, verify_and_repair
from neoworld_mjx.verify.critic import Finding, MotionCritique, ProposedEdit, strips
from neoworld_mjx.verify.repairs import repair
from neoworld_mjx.verify.verification import revise_with_models
from tests.support import answers
from tests.support import furniture as objects
from tests.support.scripted_model import ScriptedModel

BAD = objects.cupboard(lower=-0.4)
MENDS = Patch.model_validate({"joints": {"hinge": {"lower": 0.0}}})
FOUND = MotionCritique(findings=[Finding(where="door", what="swings in")], verdict="edit")


_TESTED: dict[str, ObjectTests] = {}


def results_of(spec, *options, **pose) -> ObjectTests:
    """Return the tests's run on an object; each object is simulated once for all tests."""
    key = f"{spec.to_json()} {options or VerifyOptions()} {pose}"
    if key not in _TESTED:
        _TESTED[key] = run_object_tests(spec, *options, **pose)
    return _TESTED[key]


@pytest.fixture(autouse=True)
def _each_object_is_simulated_once(monkeypatch):
    monkeypatch.setattr(verification, "run_object_tests", results_of)


def edited_by(*answers):
    """Let models edit the bad cupboard; return the repairs, the critiques and the model."""
    repaired = repair(BAD, results_of, rounds=0)
    model = ScriptedModel(*answers)
    critiques = run_coroutine(revise_with_models(repaired, model, VerifyOptions()))
    return repaired, critiques, model


def test_strips_show_failed_checks_with_labels():
    tests = results_of(BAD)
    result = strips(tests)
    assert 1 <= len(result) <= 3
    assert result[0].label == "joint_range depth:hinge"
    assert result[0].size == (880, 216)
    # The same object gives the same key on every machine; another one gives another.
    assert result[0].pixels == strips(run_object_tests(BAD))[0].pixels
    assert result[0].pixels != strips(results_of(objects.cupboard(lower=-0.5)))[0].pixels


def only_just():
    """A cupboard whose door reaches 0.9 mm into its carcass, where a millimetre is let pass."""
    return objects.cupboard(lower=-0.0035)


@pytest.mark.parametrize(
    ("value", "limit", "doubt"),
    [
        (0.79, {"threshold": 1.0}, False),
        (0.81, {"threshold": 1.0}, True),
        (1.01, {"threshold": 1.0}, False),  # It fails.
        (1.19, {"threshold": 1.0, "least": True}, True),
        (0.91, {"threshold": 0.9, "least": True, "best": 1.0}, True),
        (float("nan"), {"threshold": 1.0}, False),
    ],
)
def test_a_value_is_borderline_near_its_threshold(value, limit, doubt):
    result = make_check("static", "x", value, Limit(unit="m", fault=Fault.PARTS_OVERLAP, **limit))
    assert result.borderline is doubt


def test_a_borderline_object_is_shown_and_not_edited():
    script = ScriptedModel(FOUND)
    result = verify_and_repair(only_just(), models=Panel(script))
    assert [request.role for request in script.requests] == ["critic"]
    assert result.seen == ["door: swings in"]
    assert result.verdict.passed
    assert result.patch.empty
    script = ScriptedModel()
    verify_and_repair(objects.cupboard(), models=Panel(script))
    assert script.requests == []  # No borderline check, so no request.


def test_critic_always_shows_the_standard_scenarios_of_valid_objects():
    options = VerifyOptions(critic="always")
    script = ScriptedModel(MotionCritique(verdict="sound"))
    result = verify_and_repair(objects.cupboard(), options, models=Panel(script))
    assert result.verdict.passed
    labels = [picture.label for picture in script.requests[0].pictures]
    assert labels == ["free fall", "force perturbation"]
    slab = objects.cupboard().model_copy(
        update={"parts": objects.cupboard().parts[:1], "joints": ()}
    )
    script = ScriptedModel()
    verify_and_repair(slab, options, fixed_base=True, models=Panel(script))
    assert script.requests == []  # A support is in no scenario.


def test_a_missing_response_is_an_error_only_with_critic_always():
    lacking = lambda: Panel(ScriptedModel(MissingResponseError("no answer for simulation")))
    result = verify_and_repair(only_just(), models=lacking())
    assert result.seen == [] and "the tape does not hold the answer" in result.tried[-1]
    with pytest.raises(MissingResponseError):
        verify_and_repair(only_just(), VerifyOptions(critic="always"), models=lacking())


def test_an_edit_that_helps_is_accepted():
    repaired, critiques, _ = edited_by(FOUND, ProposedEdit(patch=MENDS))
    assert repaired.verdict.passed
    assert repaired.patch == MENDS
    assert [seen.verdict for seen in critiques] == ["edit"]


def test_direct_repairs_come_before_models():
    script = ScriptedModel()
    result = verify_and_repair(BAD, models=Panel(script))
    assert result.verdict.passed  # A direct repair cut the limits, so there was no request.
    assert script.requests == []
    flipped = objects.cupboard(axis=(0, 0, -1))
    script = ScriptedModel(MotionCritique(findings=FOUND.findings, verdict="reprogram"))
    result = verify_and_repair(flipped, models=Panel(script))
    assert not result.verdict.passed
    assert result.seen == ["door: swings in"]


@pytest.fixture
def rewritten(monkeypatch):
    """Set the object that a new program builds; return the findings that the request contains."""

    def give(spec):
        received = []

        async def reprogram(source, findings, models):
            received.append(list(findings))
            return SynthesisResult(spec, {"program": "# another program"}, (), 9.0, ())

        monkeypatch.setattr(verification, "reprogram", reprogram)
        return received

    return give


SUBJECT = Subject(answers.exact().nodes[0], Picture("crop", np.zeros((8, 8, 3), np.uint8)))
SOURCE = ProgramSource(SUBJECT, "# a program", ProgramOptions())


def test_the_verdict_reprogram_leads_to_a_new_program(rewritten):
    flipped, verdict = objects.cupboard(axis=(0, 0, -1)), MotionCritique(verdict="reprogram")
    verdict.findings.append(Finding(where="hinge", what="opens inwards", suggestion="turn it over"))
    received = rewritten(objects.cupboard())
    result = verify_and_repair(flipped, models=Panel(ScriptedModel(verdict)), source=SOURCE)
    assert result.verdict.passed and not result.before.passed
    assert result.program.text == "# another program"
    assert result.spec == objects.cupboard()
    assert received[0][0] == "hinge: opens inwards -> turn it over"
    assert received[0][1].startswith("simulated by itself: ")


def test_a_new_program_that_is_not_better_is_dropped_and_the_critic_learns_of_it(rewritten):
    flipped = objects.cupboard(axis=(0, 0, -1))
    received = rewritten(flipped)
    script = ScriptedModel(MotionCritique(verdict="reprogram"), MotionCritique(verdict="sound"))
    result = verify_and_repair(flipped, models=Panel(script), source=SOURCE)
    assert len(received) == 1 and result.program is None and not result.verdict.passed
    assert "new program: fault score" in script.requests[1].prompt


def pin():
    """A pin that stands on its point: by itself it topples."""
    shape = Box(size=(0.002, 0.002, 0.1))
    geom = GeomSpec(name="pin", shape=shape, pos=(0, 0, 0.05), material="wood")
    wood = Material(name="wood", density=700)
    return ObjectSpec(
        name="pin", materials=(wood,), parts=(PartSpec(name="pin", geoms=(geom,)),), joints=()
    )


def test_sound_waives_falls_that_fail_without_the_scene_and_nothing_else():
    sound = MotionCritique(verdict="sound")
    result = verify_and_repair(pin(), models=Panel(ScriptedModel(sound)))
    assert result.verdict.passed
    assert {check.scenario for check in result.waived} == {"free_fall"}
    assert all(check.value is not None for check in result.waived)
    flipped = objects.cupboard(axis=(0, 0, -1))
    result = verify_and_repair(flipped, models=Panel(ScriptedModel(sound)))
    assert not result.verdict.passed and not result.waived
