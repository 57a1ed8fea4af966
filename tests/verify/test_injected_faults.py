"""Object tests detect and name faults injected into valid objects, and repairs remove them."""

from functools import partial

import pytest

from neoworld_mjx.checks.object_tests import run_object_tests
from neoworld_mjx.verify.repairs import repair
from tests.support.injected_faults import KINDS
from tests.support.valid_objects import FAMILIES, valid_object

run = partial(run_object_tests, threads=1)
KIND = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)


def faulty_objects(kind, every):
    """Return every n-th pair of a valid object that can have the fault and a magnitude of it."""
    broken = [
        kind.inject(spec, magnitude)
        for spec in map(valid_object, FAMILIES)
        for magnitude in kind.magnitudes
    ]
    return [spec for spec in broken if spec is not None][::every]


def check_faults(kind, specs, failures):
    """Assert that every fault is detected and named, and how many repairs may fail."""
    repaired = 0
    for spec in specs:
        found = repair(spec, run, rounds=6 if kind.repairable else 0)
        assert found.before.cause in kind.causes, spec.name
        repaired += kind.repairable and found.verdict.passed
    assert not kind.repairable or repaired >= len(specs) - failures


@pytest.mark.parametrize("name", FAMILIES)
def test_valid_objects_pass(name):
    verdict = run(valid_object(name)).verdict
    assert verdict.passed, verdict.faults


@KIND
def test_a_fault_is_detected_named_and_repaired(kind):
    check_faults(kind, faulty_objects(kind, 1)[:1], failures=0)


@pytest.mark.slow
@KIND
def test_faults_of_all_magnitudes_are_detected_named_and_repaired(kind):
    check_faults(kind, faulty_objects(kind, 2), failures=2)
