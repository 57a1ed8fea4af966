"""The picture of measurements: the ground's grid and depths, and the requests that contain it."""

import asyncio
import copy
import dataclasses
import io

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.config import ParseOptions
from neoworld_mjx.evidence.depth_image import DepthImage
from neoworld_mjx.evidence.evidence import Evidence
from neoworld_mjx.evidence.known_camera import KnownCamera
from neoworld_mjx.parse.draw_measured import DEPTH_INK, draw_measured
from neoworld_mjx.parse.parse import parse
from neoworld_mjx.parse.prompts import correction_request, parse_request
from neoworld_mjx.parse.schema import ParsedScene
from neoworld_mjx.spec import Camera
from tests.support import answers
from tests.support.scripted_model import ScriptedModel

# A picture of 800 x 600 pixels, as that of `answers.photo`.
CAMERA = Camera(width=800, height_px=600, fovy=0.8, height=0.5, pitch=0.6, roll=0.05)
KNOWN = KnownCamera(
    (400, 300), focal=CAMERA.focal / 2, pitch=0.6, roll=0.05, height=0.5, source="camera.json"
)


def pixels(measured):
    return np.array(Image.open(io.BytesIO(measured.picture.data))).astype(int)


def cyan(image):
    """Return the excess of green over red: only the grid has one in a gray photograph."""
    return image[..., 1] - image[..., 0]


def test_grid_lies_on_the_ground_every_ten_centimeters():
    image = pixels(draw_measured(answers.photo(), KNOWN, None))
    assert image.shape == (600, 800, 3)

    def drawn(x, y):
        (u, v), _ = CAMERA.project((x, y, 0.0))
        around = cyan(image)[int(v) - 1 : int(v) + 2, int(u) - 1 : int(u) + 2]
        assert around.size
        return around.max() > 30

    # Between the labels, which are in the middle and at the ends of the lines.
    places = [(x, y) for x in (0.6, 0.7, 0.8) for y in (0.16, 0.13, -0.14, -0.17)]
    assert all(drawn(*place) for place in places)
    assert all(drawn(x, y) for x in (0.63, 0.76) for y in (0.1, 0.2, -0.1, -0.2))
    assert not any(drawn(x, y) for x in (0.65, 0.75) for y in (0.15, -0.15, 0.05, -0.05))


def test_depths_are_written_where_they_are_measured():
    values = np.full((60, 80), 0.75)
    values[:, 40:] = np.nan
    image = pixels(draw_measured(answers.photo(), None, DepthImage(values)))
    white = (image == DEPTH_INK).all(axis=-1)
    assert white[:, :400].sum() > 1000 and not white[:, 450:].any()
    assert not cyan(image).any()
    farther = pixels(draw_measured(answers.photo(), None, DepthImage(values + 0.1)))
    assert (farther != image).any()


@pytest.mark.parametrize(
    "change",
    [{"focal": None}, {"focal_sd": 0.03}, {"pitch": None}, {"height": None}, {"height": -0.1}],
)
def test_no_grid_without_the_whole_camera(change):
    known = dataclasses.replace(KNOWN, **change)
    assert draw_measured(answers.photo(), known, None) is None
    relative = DepthImage(np.ones((60, 80)), "affine")
    assert draw_measured(answers.photo(), known, relative) is None
    both = draw_measured(answers.photo(), known, DepthImage(np.ones((60, 80))))
    assert both.depths and not both.grid


def test_requests_without_measurements_are_unchanged():
    photo, response = answers.photo(), ParsedScene.model_validate(answers.desk())
    for request in (parse_request(photo), correction_request(photo, response, ["a"])):
        assert len(request.pictures) == 1 and "second picture" not in request.prompt
    models = ScriptedModel(copy.deepcopy(answers.desk()))
    options = ParseOptions(critic_rounds=0)
    relative = DepthImage(np.ones((60, 80)), "disparity")
    asyncio.run(parse(photo, models, options, Evidence(depth=relative)))
    assert models.requests[0].prompt == parse_request(photo).prompt
    sent, plain = (request.pictures for request in (models.requests[0], parse_request(photo)))
    assert [p.data for p in sent] == [p.data for p in plain]


def test_requests_show_and_explain_the_measurements():
    photo, response = answers.photo(), ParsedScene.model_validate(answers.desk())
    models = ScriptedModel(copy.deepcopy(answers.desk()))
    options = ParseOptions(critic_rounds=0)
    depth = DepthImage(np.full((60, 80), 0.7))
    asyncio.run(parse(photo, models, options, Evidence(camera=KNOWN, depth=depth)))
    request = models.requests[0]
    assert [picture.label for picture in request.pictures] == ["photo", "measured"]
    assert "z = 0, every 10 cm" in request.prompt and "measured depth at the dot" in request.prompt
    grid_only = draw_measured(photo, KNOWN, None)
    again = correction_request(photo, response, ["a"], Evidence(camera=KNOWN))
    assert again.pictures[1].data == grid_only.picture.data and "measured depth" not in again.prompt
