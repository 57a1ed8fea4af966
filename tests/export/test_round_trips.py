"""Random trees, examples and templates come back from every format as they were written."""

from pathlib import Path

import pytest

from neoworld_mjx.program import build
from neoworld_mjx.templates import templates
from tests.support import mechanisms
from tests.support.random_objects import random_object
from tests.support.round_trips import BOUNDS, LOST, READERS, compare, round_trip

OBJECTS = Path(__file__).parents[2] / "examples" / "objects"


def check_round_trip(spec, kind):
    differences = round_trip(spec, kind)
    # The facets of round shapes change the bounds of colliders.
    assert differences.pop("extent_m") < 0.02
    assert {k: v for k, v in differences.items() if v > BOUNDS[k]} == {}, spec.name


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=[pytest.mark.slow] * (seed > 0)) for seed in range(8)]
)
def test_random_trees_survive_a_round_trip(kind, seed):
    check_round_trip(random_object(seed), kind)


@pytest.mark.slow
@pytest.mark.parametrize("kind", READERS)
def test_examples_and_templates_survive_a_round_trip(kind):
    texts = [path.read_text() for path in sorted(OBJECTS.glob("*.py"))]
    texts += [t.program(t.draw(0)) for t in list(templates().values())[::4]]
    for text in texts:
        spec = build(text).spec
        assert spec is not None
        check_round_trip(spec, kind)


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize("change", [{"axis": (-0.1, 0.0, -1.0)}, {"damping": 0.03}, {"upper": 1.5}])
def test_changes_of_a_round_trip_are_detected(kind, change):
    own = mechanisms.cabinet()
    joints = [j.model_copy(update=change if j.name == "hinge" else {}) for j in own.joints]
    other = own.model_copy(update={"joints": tuple(joints)})
    differences = compare(own, other, LOST[kind])
    assert any(differences[name] > bound for name, bound in BOUNDS.items())
