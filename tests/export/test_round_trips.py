"""Random trees, examples and templates come back from every format as they were written."""

from pathlib import Path

import pytest

from neoworld_mjx.program import build
from neoworld_mjx.templates import templates
from tests.support.random_objects import random_object
from tests.support.round_trips import BOUNDS, READERS, round_trip

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
