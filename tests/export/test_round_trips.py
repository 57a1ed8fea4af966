"""Random trees and templates come back from every format as they were written."""

import pytest

from benchmarks.random_objects import random_object
from benchmarks.round_trips import BOUNDS, READERS, round_trip
from tests.support import mechanisms


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=[pytest.mark.slow] * (seed > 0)) for seed in range(4)]
)
def test_random_trees_survive_a_round_trip(kind, seed):
    differences = round_trip(random_object(seed), kind)
    assert differences.pop("extent_m") < 0.005
    assert {k: v for k, v in differences.items() if v > BOUNDS[k]} == {}


@pytest.mark.parametrize("kind", READERS)
def test_changes_of_a_round_trip_are_detected(kind):
    from benchmarks.round_trips import LOST, compare

    own = mechanisms.cabinet()
    (hinge,) = (j for j in own.joints if j.name == "hinge")
    for change in ({"axis": (-0.1, 0.0, -1.0)}, {"damping": 0.03}, {"upper": 1.5}):
        other = own.model_copy(
            update={
                "joints": tuple(
                    j.model_copy(update=change) if j is hinge else j for j in own.joints
                )
            }
        )
        found = compare(own, other, LOST[kind])
        assert any(found[name] > bound for name, bound in BOUNDS.items()), change
