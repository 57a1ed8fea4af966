"""Dimensions of programs, changed where the photograph contradicts them."""

import numpy as np
import pytest

from neoworld_mjx.estimate.align import align
from neoworld_mjx.program.freed_dimensions import (
    EditablePrograms,
    free_dimensions,
)
from neoworld_mjx.program.named_constants import named_constants, sensitivities, with_value
from neoworld_mjx.program.sandbox import build, run
from neoworld_mjx.spec import bounds, scale
from tests.estimate import desk

BRICK = """# A brick, given box 0.12 x 0.07 x 0.06 m.
from neoworld_mjx.program.sdk import Object, box

DEPTH, WIDTH, HEIGHT = 0.12, 0.07, 0.06  # of the box
EDGE = 0.004

brick = Object("brick")
green = brick.material("green", like="plastic", rgb=(0.1, 0.5, 0.15))
body = brick.part("body", material=green)
body.add(box((DEPTH, WIDTH, HEIGHT)), by="bottom")  # no rounded edges
"""
EDGES = np.array([0.12, 0.07, 0.06])


def object_of(text):
    result = run(text)
    return result.spec or "; ".join(signal.phrase() for signal in result.signals)


def fault(text):
    built = build(text)
    return "" if built.ok else "it fails its checks"


def composed_with(five, spec):
    """The five objects with another brick, as composition scales it."""
    low, high = bounds(spec)
    factor = float(np.exp(np.mean(np.log(EDGES / (high - low)))))
    objects = tuple(
        item.model_copy(update={"spec": scale(spec, factor)}) if item.name == "brick" else item
        for item in five.objects
    )
    return five.model_copy(update={"objects": objects})


def freed(five, photo, text, *, check=fault, make=object_of):
    """The result for a program of the brick."""
    spec = object_of(text)
    programs = EditablePrograms(
        {"brick": text},
        lambda name, changed: make(changed),
        lambda name, changed: check(changed),
    )
    compose = lambda specs: composed_with(five, specs.get("brick", spec))
    composed = composed_with(five, spec)
    alignment = align(composed, photo)
    again = lambda scene: align(scene, photo)
    return free_dimensions(composed, alignment, photo, programs, compose, again), composed


@pytest.fixture(scope="module")
def five():
    return desk.five()


@pytest.fixture(scope="module")
def right(five):
    return composed_with(five, object_of(BRICK))


@pytest.fixture(scope="module")
def shot(right):
    return desk.photograph(right, 640)


@pytest.mark.parametrize(
    ("name", "wrong", "within"),
    [
        # Up to a quarter of the error of 10 %.
        ("WIDTH", 0.077, 0.025),
        pytest.param("WIDTH", 0.063, 0.025, marks=pytest.mark.slow),
        pytest.param("DEPTH", 0.108, 0.025, marks=pytest.mark.slow),
        # The camera looks down on the brick, and shows least of its height.
        ("HEIGHT", 0.05, 0.03),
    ],
)
def test_a_wrong_dimension_comes_back(five, shot, name, wrong, within):
    constant = next(c for c in named_constants(BRICK) if c.name == name)
    text = with_value(BRICK, constant, wrong)
    result, _ = freed(five, shot, text)
    changed = result.alignment.dimensions["brick"]
    assert [edit.constant for edit in changed.edits] == [name]
    assert changed.edits[0].before == wrong
    assert changed.edits[0].after == pytest.approx(constant.value, rel=within)
    assert changed.outline_after_px < changed.outline_before_px
    assert changed.phrase().startswith(f"{name} {wrong:.4g} -> ")
    # The text has one other number, and builds the object of the scene.
    edited = result.texts["brick"]
    differing = [pair for pair in zip(text.split("\n"), edited.split("\n"), strict=True)
                 if pair[0] != pair[1]]  # fmt: skip
    assert len(differing) == 1 and differing[0][1].endswith("# of the box")
    assert object_of(edited) == result.specs["brick"]
    low, high = bounds(result.alignment.scene.object("brick").spec)
    np.testing.assert_allclose(high - low, EDGES, rtol=0.03)
    assert next(iter(result.alignment.notes(five)))[0].startswith("brick has other dimensions")
    assert result.alignment.to_json()["dimensions"]["brick"]["edits"][0]["constant"] == name


def test_a_right_program_is_not_changed(five, shot, right):
    result, composed = freed(five, shot, BRICK)
    assert result.composed == composed == right
    assert (result.texts, result.specs) == ({}, {})
    assert result.alignment.dimensions == {}


WRONG = BRICK.replace("0.12, 0.07, 0.06  #", "0.12, 0.077, 0.06  #")


def test_a_change_that_fails_the_checks_is_refused(five, shot):
    result, composed = freed(five, shot, WRONG, check=lambda text: "it fails free_fall drift")
    assert result.texts == {} and result.composed == composed
    assert result.alignment.scene == align(composed, shot).scene


def test_a_change_that_does_not_build_is_refused(five, shot):
    tried = []

    def make(text):
        width = next(c.value for c in named_constants(text) if c.name == "WIDTH")
        if abs(width / 0.077 - 1) < 0.011:  # Unchanged, or probed.
            return object_of(text)
        tried.append(width)
        return "no object"

    result, _ = freed(five, shot, WRONG, make=make)
    assert tried and tried[0] == pytest.approx(0.07, rel=0.06)
    changed = result.alignment.dimensions.values()
    assert "WIDTH" not in [edit.constant for each in changed for edit in each.edits]


def test_round_and_square_objects_stay_so():
    can = """from neoworld_mjx.program.sdk import Object, lathe
R, H, OVAL = 0.04, 0.12, 1.0
can = Object("can")
can.part("body", material="steel").add(lathe([(0, 0), (R, 0), (R, H)], oval=OVAL))
"""
    found = {c.name: direction for c, direction in sensitivities(can, object_of)}
    assert set(found) == {"R", "H"}
    np.testing.assert_allclose(found["H"], [-1 / 3, -1 / 3, 2 / 3], atol=0.02)
    np.testing.assert_allclose(found["R"], [1 / 3, 1 / 3, -2 / 3], atol=0.02)
    assert sensitivities("no program", object_of) == []
