"""The request that scores a candidate: criteria, pictures, listing, and a valid response."""

import json

import numpy as np
import pytest
from pydantic import ValidationError

from neoworld_mjx.config import MLLMOptions
from neoworld_mjx.mllm import Panel, Picture
from neoworld_mjx.mllm.anthropic import Anthropic
from neoworld_mjx.refinement.score_request import (
    CRITERIA,
    MAX_LEVEL,
    Judgement,
    listing,
    score_request,
    system_text,
)
from neoworld_mjx.spec import Box, SceneObject, SceneSpec
from tests.support import scenes

PHOTO = Picture.of("photo", np.random.default_rng(9).integers(0, 255, (60, 90, 3), dtype=np.uint8))


def test_request_has_the_criteria_of_the_paper():
    text = " ".join(system_text().split())
    assert "Do not judge: - whether the objects cover the same pixels" in text
    assert "the viewpoint, the framing and the lens may differ" in text
    for name in CRITERIA:
        assert f"- `{name}`:" in text


def test_photo_comes_first_and_is_cached():
    scene = scenes.furnished()
    request = score_request(PHOTO, Picture.of("candidate", np.zeros((9, 9, 3), np.uint8)), scene)
    assert [p.label for p in request.pictures] == ["photo", "candidate"]
    assert request.role == "critic"
    assert "- block: in cabinet (drawer)" in listing(scene)
    options = MLLMOptions(base_url="http://127.0.0.1:9")
    with Panel(Anthropic(options), options) as panel:
        sent = panel.provider._params(request, panel.options.critic, ())
    blocks = sent["messages"][0]["content"]
    cached = [k for k, block in enumerate(blocks) if "cache_control" in block]
    assert [blocks[k]["type"] for k in cached] == ["image"]
    assert blocks[0]["text"] == "photo:"
    assert cached == [1]
    assert "cache_control" in sent["system"][0]


def test_response_is_four_levels_with_reasons():
    good = {n: {"reason": "as it is", "level": k + 1} for k, n in enumerate(CRITERIA)}
    assert Judgement.model_validate(good).value == 10 / 16
    for level in (5, -1, 2.5, "3", True, None):
        with pytest.raises(ValidationError):
            Judgement.model_validate_json(
                json.dumps(good | {"intersections": {"reason": "", "level": level}})
            )
    del good["relative_size"]
    with pytest.raises(ValidationError):
        Judgement.model_validate(good)


def test_value_levels_and_reasons_are_those_of_the_four_criteria():
    """Each criterion counts alike, and the levels are listed in the paper's order."""
    assert CRITERIA == ("depth_ordering", "relative_size", "relative_orientation", "intersections")
    assert MAX_LEVEL == 4
    for k, name in enumerate(CRITERIA):
        levels = dict.fromkeys(CRITERIA, 0) | {name: 4}
        judged = Judgement.model_validate(
            {n: {"reason": f"{n} {level}", "level": level} for n, level in levels.items()}
        )
        assert judged.value == 0.25 and judged.levels == levels
        assert judged.reasons == {n: f"{n} {level}" for n, level in levels.items()}
        assert [*judged.levels][k] == name


def test_the_listing_says_where_each_object_stands():
    block = scenes.single("block", (Box(size=(0.1, 0.1, 0.1)), (0, 0, 0)))
    objects = (
        SceneObject(name="desk", spec=block, environment=True),
        SceneObject(name="stool", spec=block),
        SceneObject(name="cup", spec=block, parent="desk"),
        SceneObject(name="lamp", spec=block, parent="desk", relation="leaning"),
    )
    assert listing(SceneSpec(name="room", objects=objects)).split("\n") == [
        "- desk: the environment",
        "- stool: stands by itself",
        "- cup: on desk",
        "- lamp: leaning desk",
    ]
