"""The critic sees labelled strips; the reasoner's edits are kept only where they help."""

import furniture as objects
import pytest

from neoworld_mjx.errors import MissingAnswerError, ModelError
from neoworld_mjx.mllm import Answer, Usage
from neoworld_mjx.verify import Battery, Patch, Repaired, make_sound
from neoworld_mjx.verify.critic import Edited, Finding, Seen, edit, shown, with_models
from neoworld_mjx.verify.strips import doubtful, strips

BAD = objects.cupboard(lower=-0.4)
MENDS = Patch.model_validate({"joints": {"hinge": {"lower": 0.0}}})
HARMS = Patch.model_validate({"joints": {"hinge": {"lower": -0.6}}})
FOUND = Seen(findings=[Finding(where="door", what="swings in")], verdict="edit")


class Script:
    """Answers in the order given; an exception is raised."""

    def __init__(self, *answers):
        self.answers, self.asked = list(answers), []

    def ask_sync(self, request):
        self.asked.append(request)
        value = self.answers.pop(0)
        if isinstance(value, Exception):
            raise value
        return Answer(value, "", Usage(), "script")


def tried(*answers):
    battery = Battery(BAD)
    made = Repaired(BAD, Patch(), battery.verdict, battery.verdict)
    script = Script(*answers)
    told = with_models(made, battery, script, Battery, BAD)
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
    assert all(c.outcome == "PASS" for c in filter(doubtful, battery.verdict.checks))
    assert all("FAIL" not in line for line in shown(battery).prompt.splitlines())


def test_requests_tell_the_numbers_and_what_may_be_edited():
    battery = Battery(BAD)
    request = shown(battery)
    assert request.role == "critic"
    assert "FAIL joint_range depth:hinge" in request.prompt
    asked = edit(battery, FOUND)
    assert asked.role == "reasoner"
    assert "swings in" in asked.prompt
    assert "joint hinge: revolute, door on carcass" in asked.prompt


def test_an_edit_that_helps_is_kept():
    made, told, _ = tried(FOUND, Edited(patch=MENDS))
    assert made.after.passed
    assert made.patch == MENDS
    assert [seen.verdict for seen in told] == ["edit"]


@pytest.mark.parametrize(
    "patch", [HARMS, Patch.model_validate({"parts": {"door": {"mass": 900.0}}})]
)
def test_an_edit_that_does_not_help_is_dropped_and_listed(patch):
    made, _, _ = tried(FOUND, Edited(patch=patch))
    assert made.patch.empty
    assert made.after == made.before
    assert len(made.tried) == 1


def test_what_must_be_programmed_anew_is_not_edited():
    made, told, script = tried(Seen(verdict="reprogram"))
    assert (made.patch.empty, len(told), len(script.asked)) == (True, 1, 1)


def test_a_server_that_fails_costs_the_edit_not_the_run():
    made, told, _ = tried(ModelError("gone"))
    assert told == []
    assert "was not answered: gone" in made.tried[0]
    with pytest.raises(MissingAnswerError):
        tried(MissingAnswerError("the tape has none"))


def test_numbers_come_first():
    script = Script()
    result = make_sound(BAD, models=script)
    assert result.verdict.passed  # Cut by direct repair: nobody was asked.
    assert script.asked == []
    flipped = objects.cupboard(axis=(0, 0, -1))
    script = Script(Seen(findings=FOUND.findings, verdict="reprogram"))
    result = make_sound(flipped, models=script)
    assert not result.verdict.passed
    assert result.seen == ("door: swings in",)
