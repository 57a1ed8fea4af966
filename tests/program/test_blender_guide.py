"""The guide to programs in Blender: its blocks build and behave where Blender is installed."""

import re
from importlib import resources

import numpy as np
import pytest

from neoworld_mjx.checks.object_tests import run_object_tests
from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program import build
from neoworld_mjx.program.ask import instructions
from neoworld_mjx.program.blender.blender_process import unavailable
from neoworld_mjx.program.stages import STAGES
from neoworld_mjx.program.supports import MATERIALS
from neoworld_mjx.spec import bounds

GUIDE = resources.files("neoworld_mjx.program").joinpath("blender_guide.md").read_text("utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL)
GIVEN = re.compile(r"given box ([\d.]+) x ([\d.]+) x ([\d.]+) m")


@pytest.mark.slow
@pytest.mark.parametrize(
    "text", BLOCKS, ids=lambda text: re.search(r'"object"\] = "(\w+)', text)[1]
)
def test_every_block_of_the_blender_guide_builds_and_behaves(text):
    why = unavailable()
    if why is not None:
        pytest.skip(why)
    built = build(text, ProgramOptions(language="blender"))
    assert built.ok and built.signals == ()
    verdict = run_object_tests(built.spec).verdict
    assert verdict.passed, [(c.name, c.value) for c in verdict.checks if c.outcome == "FAIL"]
    given = GIVEN.search(text)
    if given is not None:
        low, high = bounds(built.spec)
        assert np.abs((high - low) / [float(v) for v in given.groups()] - 1).max() < 0.03


def test_the_blender_guide_lists_every_material():
    listed = re.search(r"usual colour: (.*?)\.\n", GUIDE, re.DOTALL)
    assert listed is not None
    assert set(re.split(r",\s+", listed[1])) == set(MATERIALS)


@pytest.mark.parametrize("file", [stage.file for stages in STAGES.values() for stage in stages])
def test_each_stage_has_instructions_of_its_language(file):
    sdk, blender = instructions(file), instructions(file, "blender")
    assert "bpy" in blender and "bpy" not in sdk
    assert "program.sdk" not in blender
    assert len(blender) / 3 < 12_000
