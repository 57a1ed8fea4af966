"""The objects of examples/objects: each builds, and passes every compile check."""

from pathlib import Path

import pytest

from neoworld_mjx.program import build

PROGRAMS = sorted((Path(__file__).parents[2] / "examples" / "objects").glob("*.py"))


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.stem)
def test_each_program_builds_and_passes_its_checks(path):
    built = build(path.read_text(encoding="utf-8"))
    errors = [signal.phrase() for signal in built.signals if signal.severity == "error"]
    assert built.spec is not None and not errors, errors
    assert any(joint.type != "fixed" for joint in built.spec.joints), (
        "each of them has moving parts"
    )
