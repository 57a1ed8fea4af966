import asyncio
import copy
import json

import pytest

from neoworld_mjx.config import ParseOptions
from neoworld_mjx.errors import ModelError
from neoworld_mjx.parse.parse import parse
from tests.support import answers
from tests.support.scripted_model import ScriptedModel

GOOD = {"faults": [], "boxes": 10, "completeness": 9, "hierarchy": 9.5}
BAD = {
    "faults": [
        {"node": None, "kind": "missing", "what": "A pen at the edge.", "correction": "Add pen."}
    ],
    "boxes": 9,
    "completeness": 6,
    "hierarchy": 9,
}


def consistent(data=None):
    """An answer whose 2D boxes are those of its 3D boxes."""
    data = copy.deepcopy(data or answers.desk())
    tree = answers.exact(data)
    for obj in data["objects"]:
        box = tree.node(obj["name"]).box2d.as_tuple()
        obj["box"] = dict(zip(("left", "top", "right", "bottom"), box, strict=True))
    return data


def run(*texts, photo=None, **options):
    models = ScriptedModel(*texts)
    parsed = asyncio.run(parse(photo or answers.photo(), models, ParseOptions(**options)))
    assert not models.answers
    return parsed, [request.name for request in models.requests], models.requests


def test_an_accepted_response_takes_two_requests():
    parsed, names, requests = run(consistent(), GOOD)
    assert names == ["parse", "parse:judge"]
    assert [request.role for request in requests] == ["reasoner", "critic"]
    assert requests[1].pictures[0].pixels == requests[0].pictures[0].pixels
    assert parsed.checks == ()
    assert parsed.picture.startswith(b"\x89PNG")
    data = json.loads(parsed.to_json())
    assert [r["kept"] for r in data["rounds"]] == [True]
    assert data["rounds"][0]["verdict"]["boxes"] == 10


def test_without_critic_rounds_no_critic_is_asked():
    parsed, names, _ = run(consistent(), critic_rounds=0)
    assert names == ["parse"]
    assert len(parsed.rounds) == 1


def test_faults_go_back_and_the_better_round_is_kept():
    better = consistent()
    better["objects"][1]["description"] = "now with a pen"
    parsed, names, requests = run(consistent(), BAD, better, GOOD)
    assert names == ["parse", "parse:judge", "parse:mend", "parse:judge"]
    assert "A pen at the edge. Add pen." in requests[2].prompt
    assert parsed.best_round == 1
    assert parsed.tree.node("left").description == "now with a pen"


def test_a_round_with_a_lower_score_is_not_kept():
    worse = {"removed": ["right", "can"]}
    parsed, _, requests = run(consistent(), BAD, worse, BAD | {"completeness": 2})
    assert "lists 2 objects" in requests[3].prompt
    assert parsed.best_round == 0
    assert len(parsed.tree.nodes) == 4


def test_a_correction_contains_only_what_changes():
    can = consistent()["objects"][3] | {"description": "now with a tab"}
    pen = can | {"name": "pen", "label": "pen"}
    correction = {"objects": [can, pen], "removed": ["right"]}
    parsed, _, requests = run(consistent(), BAD, correction, GOOD)
    assert "required" not in requests[2].json_schema
    names = [node.name for node in parsed.tree.nodes]
    assert names == ["table", "left", "can", "pen"]
    assert parsed.tree.node("can").description == "now with a tab"
    assert parsed.tree.node("left").description == consistent()["objects"][1]["description"]


def test_a_correction_that_leaves_an_inconsistent_scene_goes_back():
    parsed, names, requests = run(
        consistent(), BAD, {"removed": ["table"]}, {"objects": []}, critic_rounds=3
    )
    assert names == ["parse", "parse:judge", "parse:mend", "parse:mend"]
    assert "parent 'table' is not a node" in requests[3].prompt
    assert parsed.best_round == 0


def test_rounds_are_bounded():
    other = consistent()
    other["objects"][1]["description"] = "other"
    _, names, _ = run(consistent(), BAD, other, BAD, consistent(), BAD, critic_rounds=2)
    assert names.count("parse:mend") == 2


def test_errors_of_the_checks_go_back_even_if_the_critic_is_content():
    wrong = consistent()
    wrong["objects"][3]["parent"] = "right"  # the can, far from it
    parsed, names, requests = run(wrong, GOOD, consistent(), GOOD)
    assert names[2] == "parse:mend"
    assert "can: only 0% of its footprint lies in that of its support right" in requests[2].prompt
    assert parsed.best_round == 1
    assert parsed.tree.node("can").parent == "left"


def test_a_finding_that_the_critic_dismisses_costs_no_round():
    data = consistent()
    data["objects"][3]["position"]["z"] = 0.6  # The can floats.
    kept, names, requests = run(data, GOOD | {"dismissed": [1, 2, 3, 4]})
    assert names == ["parse", "parse:judge"]
    assert "1. can: " in requests[1].prompt
    assert "dismissed" in requests[1].prompt
    assert kept.checks == ()
    assert kept.rounds[0].checks
    _, names, _ = run(data, GOOD, consistent(), GOOD)
    assert names[2] == "parse:mend"


def test_only_invalid_responses_are_one_error():
    outside = consistent()
    outside["objects"][1]["box"] = {"left": 900, "top": 10, "right": 950, "bottom": 50}
    other = copy.deepcopy(outside)
    other["objects"][1]["description"] = "other"
    with pytest.raises(ModelError, match=r"no response of 2 gave a scene.*outside the picture"):
        run(outside, other)


def test_a_failed_critic_is_a_fallback():
    parsed, _, _ = run(consistent(), ModelError("the critic is out"))
    assert parsed.fallbacks == (("no judge round", "the critic is out"),)
    assert parsed.rounds[0].verdict is None


def test_a_distance_that_step_4_corrects_is_kept_and_not_asked_about():
    wrong = consistent()
    wrong["objects"][2]["position"]["y"] += 0.03
    parsed, names, _ = run(wrong, GOOD)
    assert names == ["parse", "parse:judge"]
    assert parsed.checks == ()
    assert parsed.tree.node("right").box3d.position[1] == pytest.approx(-0.12)
