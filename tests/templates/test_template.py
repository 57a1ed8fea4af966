"""Reading templates, and their instances: what builds, what it measures, what is refused."""

import numpy as np
import pytest

from neoworld_mjx.checks.compile_checks import check
from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.errors import SpecError
from neoworld_mjx.program.building import run
from neoworld_mjx.spec import bounds
from neoworld_mjx.templates import read_template, template, templates
from neoworld_mjx.templates.template import BOX

SMALL = """# Label: block
from neoworld_mjx.program.sdk import Object, box

depth = 0.2  # 0.1 to 0.3 m
width = 0.2  # 0.1 to 0.3 m
height = 0.1  # 0.05 to 0.3 m
bores = 2  # 1 to 4
wood = "oak"  # one of oak, pine
KEEP = 0.5
o = Object("block")
o.part("body", material=wood).add(box((depth, width, height)), by="bottom")
"""


@pytest.fixture
def block(tmp_path):
    path = tmp_path / "block.py"
    path.write_text(SMALL)
    return read_template(path)


def test_an_instance_differs_only_in_its_constants(block):
    changed = block.program({"depth": 0.25, "bores": 3, "wood": "pine"})
    pairs = zip(SMALL.splitlines(), changed.splitlines(), strict=True)
    differ = [b for a, b in pairs if a != b]
    assert differ == [
        "depth = 0.25  # 0.1 to 0.3 m",
        "bores = 3  # 1 to 4",
        'wood = "pine"  # one of oak, pine',
    ]
    assert block.program() == SMALL


def test_a_seed_draws_the_same_values_within_their_ranges(block):
    for seed in range(50):
        values = block.draw(seed)
        assert values == block.draw(seed)
        assert 0.1 <= values["depth"] <= 0.3 and values["bores"] in (1, 2, 3, 4)
        assert block.program(values)
    assert len({str(block.draw(seed)) for seed in range(50)}) == 50


def test_a_box_is_clipped_to_the_ranges(block):
    assert block.of_box((0.25, 1.0, 0.01)) == {"depth": 0.25, "width": 0.3, "height": 0.05}


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"colour": "red"}, "template block, parameter: got 'colour'"),
        ({"wood": "steel"}, "wood: got 'steel', valid are: oak, pine"),
        ({"depth": 3.0}, "depth: 3.0 is outside 0.1 to 0.3 m"),
        ({"depth": "deep"}, "depth: 'deep' is outside"),
        ({"depth": float("nan")}, "depth: nan is outside"),
    ],
)
def test_wrong_values_are_named(block, values, message: str):
    with pytest.raises(SpecError, match=message):
        block.program(values)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("# Label: block\n", "", "'# Label: ...'"),
        ("  # 0.1 to 0.3 m\nwidth", "\nwidth", "no parameter depth"),
        ("# 1 to 4", "# some", "bores needs"),
        ("bores = 2", "bores = 9", "the default of bores: 9 is outside"),
        ('wood = "oak"', 'wood = "tin"', "the default of wood: got 'tin'"),
    ],
)
def test_a_broken_template_is_named(tmp_path, old: str, new: str, message: str):
    path = tmp_path / "broken.py"
    path.write_text(SMALL.replace(old, new))
    with pytest.raises(SpecError, match=message):
        read_template(path)


# One of sixteen; the slow run builds all.
CASES = [
    pytest.param(name, marks=[pytest.mark.slow] if k % 16 else [])
    for k, name in enumerate(templates())
]


@pytest.mark.parametrize("name", CASES)
def test_every_template_builds_to_its_box(name: str):
    drawn = template(name)
    for values in ({}, drawn.draw(0)):
        # Limits of time are for one program on a machine of its own, which this one need not be.
        options = ProgramOptions(timeout_s=10.0, check_timeout_s=10.0)
        built = run(drawn.program(values), options)
        assert built.spec is not None, built.signals
        signals = check(built.spec, options, built.lines, built.allowances)
        assert [s for s in signals if s.severity == "error"] == []
        low, high = bounds(built.spec)
        size = [values.get(key, drawn.parameters[key].default) for key in BOX]
        assert np.abs(high - low - size).max() <= max(0.003, 0.02 * max(size))
        assert built.spec.joints, "a template is articulated"
