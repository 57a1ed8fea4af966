"""Requests are known by their content, not by their name or how their pictures were compressed."""

import asyncio
import io

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.errors import BudgetError, MissingResponseError, ModelError
from neoworld_mjx.mllm import Picture, ask_or_record
from neoworld_mjx.parse.prompts import SceneCritique
from neoworld_mjx.parse.schema import ParsedScene
from neoworld_mjx.program.ask import ProgramResponse
from neoworld_mjx.program.critique import ArticulationCritique, ExportCritique, GeometryCritique
from neoworld_mjx.verify.critic import MotionCritique, ProposedEdit
from tests.support.scripted_model import ScriptedModel


def test_keys_of_requests_are_stable(make):
    # A change here breaks every tape that anybody has recorded.
    plain = make.request(pictures=[Picture("photo", np.zeros((16, 16, 3), np.uint8))])
    assert plain.key == "ad95deb91565b013ecab0d22328a954dc818ac75d0f93649ff37e5b9818ad9c7"


@pytest.mark.parametrize(
    "changes",
    [
        lambda make: {"role": "critic"},
        lambda make: {"system": "You see!"},
        lambda make: {"prompt": "Which colour ?"},
        lambda make: {"schema": make.Shade},
        lambda make: {"pictures": []},
        lambda make: {"pictures": [Picture("crop", make.noise())]},
        lambda make: {"pictures": [Picture("photo", make.noise(1))]},
        lambda make: {"pictures": [Picture("photo", make.noise().reshape(30, 20, 3))]},
    ],
)
def test_key_covers(make, changes):
    assert make.request(**changes(make)).key != make.request().key


def test_key_leaves_out_name_and_compression(make):
    buffer = io.BytesIO()
    Image.fromarray(make.noise()).save(buffer, "PNG", compress_level=0, optimize=False)
    other = Picture("photo", buffer.getvalue())
    assert other.data != Picture("photo", make.noise()).data
    assert make.request(name="again", pictures=[other]).key == make.request().key


def test_data_that_is_no_picture_is_rejected():
    with pytest.raises(ModelError, match="'photo' must be PNG or JPEG"):
        Picture("photo", b"GIF89a")
    with pytest.raises(ModelError, match="'photo' must be uint8"):
        Picture("photo", np.zeros((3, 3, 3)))
    with pytest.raises(ModelError, match="'photo' cannot be decoded"):
        _ = Picture("photo", b"\x89PNG\r\n\x1a\nnothing").pixels


@pytest.mark.parametrize(
    ("schema", "digest_start"),
    [
        (ParsedScene, "734f92b99f298641"),
        (SceneCritique, "f7f32e8731f015d8"),
        (ProgramResponse, "579e10f0326556b3"),
        (GeometryCritique, "697b892b2191aea9"),
        (ArticulationCritique, "dc034d1408b08466"),
        (ExportCritique, "6df1d791495d7c56"),
        (MotionCritique, "4149a114de3ac0e8"),
        (ProposedEdit, "732cc387a9bac9c2"),
    ],
)
def test_schemas_of_responses_are_fixed(make, schema, digest_start):
    # Names, docstrings and descriptions are part of them: a change here breaks recorded tapes.
    assert make.request(schema=schema).parts["schema"].startswith(digest_start)


def ask(answer, request):
    fallbacks: list[tuple[str, str]] = []
    model = ScriptedModel(answer)
    return asyncio.run(ask_or_record(model, request, "no judge round", fallbacks)), fallbacks


def test_a_failing_model_is_recorded_as_a_fallback(make):
    assert ask({"name": "red"}, make.request()) == (make.Colour(name="red"), [])
    assert ask(ModelError("down"), make.request()) == (None, [("no judge round", "down")])


@pytest.mark.parametrize("error", [BudgetError("cap"), MissingResponseError("tape")])
def test_budget_and_missing_response_errors_end_the_run(make, error):
    with pytest.raises(type(error)):
        ask(error, make.request())
