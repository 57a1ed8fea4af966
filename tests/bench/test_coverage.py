"""Errors of aligned objects in stated standard deviations, of a desk with known displacements."""

import math

import numpy as np
import pytest
from neoworld_bench.methods.stated_deviations import object_errors, stated_deviations
from neoworld_bench.tables.scene_figures import coverage

from neoworld_mjx.spec.scene import PoseUncertainty
from tests.bench.test_scene_set import row_of
from tests.estimate import desk

KNOWN = PoseUncertainty(along=0.01, across=0.002, yaw=math.radians(2), log_scale=0.03)


def errors(change, name="box"):
    """Errors of one object of the desk after a change; all objects have KNOWN deviations."""
    truth = desk.five()
    moved = [
        item.model_copy(update={"uncertainty": KNOWN, **(change if item.name == name else {})})
        for item in truth.objects
    ]
    found = list(object_errors(truth.model_copy(update={"objects": tuple(moved)}), truth))
    index = [item.name for item in truth.objects if item.parent].index(name)
    # Of a ball and a can there is no heading.
    before = sum(3 if item.name in ("can", "ball") else 4 for item in truth.objects[1 : 1 + index])
    return dict(found[before : before + (3 if name in ("can", "ball") else 4)])


def test_a_displacement_is_split_along_and_across_the_view():
    box = desk.five().object("box")
    x, y = 0.9 + box.xy[0], box.xy[1]
    length = math.hypot(x, y)
    ahead = (box.xy[0] + 0.02 * x / length, box.xy[1] + 0.02 * y / length)
    found = errors({"xy": ahead})
    assert found["along"] == pytest.approx(2.0) and found["across"] == pytest.approx(0.0, abs=1e-6)
    aside = (box.xy[0] - 0.003 * y / length, box.xy[1] + 0.003 * x / length)
    found = errors({"xy": aside})
    # The view turns with the object by a hundredth of the displacement.
    assert found["across"] == pytest.approx(1.5, abs=0.01) and found["along"] < 0.01


def test_the_coverage_counts_the_intervals_that_hold_the_truth():
    rows = [
        row_of("ours", valid=True, scene=f"scene {k}", deviations={"yaw": list(0.1 * numbers)})
        for k, numbers in enumerate(np.arange(40).reshape(8, 5).T)
    ]
    rows.append(row_of("ours", valid=True, scene="scene 0", start=1, deviations={"along": [9.0]}))
    row, other = coverage(rows)
    assert row["n"] == 40 and row["half"] == "development" and row["quantity"] == "yaw"
    # 1.645 deviations: the errors 0 to 1.6.
    assert row["held"] == pytest.approx(17 / 40)
    assert row["low"] < 17 / 40 < row["high"]
    assert row["factor"] == pytest.approx(3.51 / 1.645)
    assert (other["half"], other["held"]) == ("evaluation", 0.0)


def test_deviations_are_grouped_by_quantity():
    truth = desk.five()
    known = [item.model_copy(update={"uncertainty": KNOWN}) for item in truth.objects]
    found = stated_deviations(truth.model_copy(update={"objects": tuple(known)}), truth)
    assert len(found["yaw"]) == len(found["along"]) - 2, "a can and a ball have no heading"
    assert stated_deviations(truth, truth) == {}
