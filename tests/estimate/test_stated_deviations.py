"""Deviations of objects and camera that a response states, and known edges, in the prior."""

import math

import numpy as np
import pytest

from neoworld_mjx.config import AlignOptions, ComposeOptions
from neoworld_mjx.estimate.align import align_to_boxes
from neoworld_mjx.estimate.prior import (
    ACROSS,
    DEPTH,
    KNOWN_EDGE,
    LOG_HEIGHT,
    LOG_SIZE,
    MEASURED,
    PITCH,
    YAW,
    camera_deviations,
    prior_precision,
)
from neoworld_mjx.estimate.problem import PLANE_DEVIATIONS
from neoworld_mjx.evidence.evidence import Evidence
from neoworld_mjx.pipeline.place import place
from neoworld_mjx.spec import Cues, SceneSpec, bounds
from tests.estimate import desk

WITHOUT_PIXELS = ComposeOptions(align=AlignOptions(enabled=False))


def with_cues(scene, **cues):
    """The scene with stated cues of some objects, by name."""
    objects = [
        item.model_copy(update={"cues": cues[item.name]}) if item.name in cues else item
        for item in scene.objects
    ]
    return scene.model_copy(update={"objects": tuple(objects)})


def size_ratio(scene, truth, name):
    sizes = [np.subtract(*bounds(s.object(name).spec)) for s in (scene, truth)]
    return float(np.linalg.norm(sizes[0]) / np.linalg.norm(sizes[1]))


def deviations(scene, name):
    """Prior standard deviations of an object: along and across the view [m], yaw, log size."""
    unknowns = desk.unknowns_of(scene)
    x, k = np.zeros(unknowns.size), scene.index(name)
    now = unknowns.place(x[None])[0]
    prior = prior_precision(unknowns, now, x, camera_deviations((), {}, misjudged=False))
    own = np.linalg.inv(prior)[unknowns.columns(k), unknowns.columns(k)]
    axes = unknowns.view_axes(now, k)
    across = np.sqrt(np.diag(axes @ own[:2, :2] @ axes.T))
    distance = np.linalg.norm(now.pos[k] - now.camera.position())
    return [*across.tolist(), *np.sqrt(np.diag(own)[2:]).tolist()], float(distance)


def parsed(scene, cues, **tree):
    """The parse of a scene, in which the can is 15 % too large, with stated cues by name."""
    return desk.parsed(scene, {"can": 1.15}, cues=cues, **tree)


def test_stated_deviations_replace_the_constants_within_a_factor_of_four(five):
    cues = Cues(position_sd=0.03, size_sd=0.08, yaw_sd=math.radians(8))
    (along, across, yaw, size), distance = deviations(with_cues(five, box=cues), "box")
    assert along == pytest.approx(0.03)
    assert across == pytest.approx(min(0.03, 4 * ACROSS * distance))
    assert (yaw, size) == pytest.approx((math.radians(8), 0.08))
    for value, factor in ((1e-6, 1 / 4), (1e3, 4.0)):
        extreme = Cues(position_sd=value, size_sd=value, yaw_sd=value)
        found, _ = deviations(with_cues(five, box=extreme), "box")
        constants = [DEPTH * distance, ACROSS * distance, YAW, LOG_SIZE]
        assert found == pytest.approx([factor * constant for constant in constants])
    assert deviations(with_cues(five, box=cues), "tower") == deviations(five, "tower")


def test_an_edge_of_standard_length_makes_the_size_certain(five):
    cues = Cues(known_size=("z",), size_sd=0.1)
    assert deviations(with_cues(five, box=cues), "box")[0][3] == pytest.approx(KNOWN_EDGE)


def test_boxes_change_a_size_that_the_response_doubts(five):
    wrong = desk.displaced(desk.boxed(five), can=(0, 0, 0, 15))
    sure, doubted = (
        size_ratio(align_to_boxes(scene).scene, five, "can")
        for scene in (wrong, with_cues(wrong, can=Cues(size_sd=0.1)))
    )
    assert abs(doubted - 1) < 0.03 < 0.06 < sure - 1


def test_a_parsed_doubt_counts_in_the_placed_scene(five):
    objects = {item.name: item.spec for item in five.objects}
    found = {
        size_sd: place(
            parsed(five, {"can": Cues(size_sd=size_sd)}), objects, options=WITHOUT_PIXELS
        ).scene
        for size_sd in (None, 0.1)
    }
    errors = {key: size_ratio(scene, five, "can") - 1 for key, scene in found.items()}
    assert abs(errors[0.1]) < 0.03 < 0.06 < errors[None]
    again = SceneSpec.model_validate_json(found[0.1].to_json())
    assert again.object("can").cues == Cues(size_sd=0.1)
    assert '"cues"' not in found[None].to_json()


def test_a_size_known_along_all_axes_is_kept_exactly(five, photo):
    tree = parsed(five, {"can": Cues(known_size=("x", "y", "z"))})
    objects = {item.name: item.spec for item in five.objects}
    scene = place(tree, objects, Evidence(photo)).scene
    assert scene.object("can").known == "size" and scene.object("box").known is None
    assert size_ratio(scene, five, "can") == pytest.approx(1.15, rel=1e-6)


def test_a_stated_deviation_of_the_camera_replaces_the_constant():
    def pitch_and_height(measured=(), known=None, **stated):
        found = camera_deviations(measured, known or {}, stated, misjudged=False)
        return found[[0, 3]].tolist()

    assert pitch_and_height() == [PITCH, LOG_HEIGHT]
    # A stated deviation says more than that the parameter was measured.
    both = ("pitch", "height")
    assert pitch_and_height(both, pitch=0.05, height=0.02) == [0.05, 0.02]
    assert pitch_and_height(both, height=0.1) == [MEASURED * PITCH, 0.1]
    assert pitch_and_height(pitch=1e-6, height=1.0) == [PITCH / 4, 4 * LOG_HEIGHT]
    assert pitch_and_height((), PLANE_DEVIATIONS, pitch=0.1) == [
        PLANE_DEVIATIONS["pitch"],
        PLANE_DEVIATIONS["height"],
    ]


def test_a_stated_doubt_widens_the_camera(five):
    """A pitch that is 3 degrees off comes back by the boxes only if the response doubts it."""
    tilted = five.camera.model_copy(update={"pitch": five.camera.pitch + math.radians(3)})
    objects = {item.name: item.spec for item in five.objects}
    changes = []
    for doubt in ({}, {"pitch_sd": math.radians(5)}):
        tree = parsed(five, {}, **doubt)
        tree = tree.model_copy(update={"camera": tilted})
        done = place(tree, objects, options=WITHOUT_PIXELS).by_boxes
        assert done is not None
        changes.append((done.pitch_deg, done.camera["pitch"].deviation))
    (sure, narrow), (doubted, wide) = changes
    assert doubted < sure - 0.3 and wide > 1.1 * narrow
