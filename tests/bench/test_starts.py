"""Starts of the thirty scenes: levels of noise, and how missed and extra objects count."""

import pytest

from neoworld_mjx.bench.dataset.declaration import declarations
from neoworld_mjx.bench.dataset.layout_errors import displaced, layout_errors, unmatched
from neoworld_mjx.bench.dataset.truth_scene import truth_scene


def test_missed_and_extra_objects_are_counted_and_no_error():
    truth = truth_scene(declarations()["dominoes"])
    first, *others = truth.objects[1:]
    doubled = others[0].model_copy(update={"name": "ghost", "xy": (9.0, 9.0)})
    wrong = truth.model_copy(update={"objects": (truth.objects[0], *others, doubled)})
    assert unmatched(wrong, truth) == ([first.name], ["ghost"])
    assert unmatched(truth, truth) == ([], [])
    assert displaced(wrong, truth) == []
    assert layout_errors(wrong, truth) == layout_errors(truth, truth)
    # Of what is found, an error is not thinned by what is missing.
    pushed = others[0].model_copy(update={"xy": (others[0].xy[0] + 0.03, others[0].xy[1])})
    scene = wrong.model_copy(update={"objects": (truth.objects[0], pushed, *others[1:])})
    found = [item for item in others if not item.static]
    assert layout_errors(scene, truth)["xy_error_m"] == pytest.approx(0.03 / len(found))
