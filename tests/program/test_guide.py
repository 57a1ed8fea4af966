import re
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from neoworld_mjx.checks.object_tests import run_object_tests
from neoworld_mjx.program import build
from neoworld_mjx.program.building import run
from neoworld_mjx.program.supports import MATERIALS
from neoworld_mjx.spec import bounds, link_poses

GUIDE = resources.files("neoworld_mjx.program").joinpath("guide.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL)
GIVEN = re.compile(r"given box ([\d.]+) x ([\d.]+) x ([\d.]+) m")


@pytest.mark.parametrize("text", BLOCKS, ids=lambda text: re.search(r'Object\("(\w+)', text)[1])
def test_every_block_builds_without_signals_and_passes_the_object_tests(text: str):
    built = build(text)
    assert built.spec is not None and built.signals == ()
    again = run(text)
    assert again.spec is not None and again.spec.to_json() == built.spec.to_json()
    given = GIVEN.search(text)
    if given is not None:
        low, high = bounds(built.spec)
        wanted = np.array([float(v) for v in given.groups()])
        assert np.abs((high - low) / wanted - 1).max() < 0.03
    verdict = run_object_tests(built.spec).verdict
    assert verdict.passed, [(c.name, c.value) for c in verdict.checks if c.outcome == "FAIL"]


def test_the_page_of_the_docs_builds_too():
    page = Path(__file__).parents[2].joinpath("docs/programs.md").read_text(encoding="utf-8")
    block = re.findall(r"```python\n(.*?)```", page, re.DOTALL)[0]
    built = build(block)
    assert built.ok and built.signals == ()


def test_every_material_and_shape_is_listed():
    listed = re.search(r"Named: (.*?)\.\n", GUIDE, re.DOTALL)
    assert listed is not None
    assert set(re.split(r",\s+", listed[1])) == set(MATERIALS)
    from neoworld_mjx.program import sdk

    for name in sdk.__all__:
        if name[0].islower():
            assert f"`{name}(" in GUIDE, name


def test_the_second_colour_applies_to_the_usual_pattern_of_a_name():
    text = """
from neoworld_mjx.program.sdk import Object, box

board = Object("board")
body = board.part("body", material=board.material({name}, like="pine", rgb2=(0.4, 0.2, 0.1)))
body.add(box((0.2, 0.3, 0.02)), by="bottom")
"""
    built = run(text.format(name='"warm_wood"'))
    assert built.ok, built.signals
    (material,) = (m for m in built.spec.materials if m.name == "warm_wood")
    assert material.pattern.kind == "grain" and material.pattern.rgb == (0.4, 0.2, 0.1)
    plain = run(text.format(name='"steel_sheet"'))
    assert "need a pattern=" in " ".join(signal.message for signal in plain.signals)


ROWS = re.findall(r"^\| (.+?) \| (.+?) \| (.+?) \| `(\(.+?\))` \|$", GUIDE, re.MULTILINE)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row[0]}, {row[1]}")
def test_positive_opens_as_the_table_says(row: tuple[str, str, str, str]):
    """Build each row's part before, or on, a body and see that positive moves it out."""
    what, _, at, axis = row
    slides = at == "-"
    lid = what.startswith("lid")
    place = "top" if lid else "front"
    by = "bottom" if lid else "back"
    anchor = at.strip("`").split(".", 1)[-1] if not slides else ""
    text = f"""from neoworld_mjx.program.sdk import Object, box
o = Object("thing")
body = o.part("body", material="oak")
body.add(box((0.4, 0.4, 0.4)))
p = o.part("p", material="oak")
p.add(
    box({"(0.4, 0.4, 0.02)" if lid else "(0.02, 0.4, 0.4)"}), at=body.anchor("{place}"), by="{by}"
)
"""
    if slides:
        text += f"o.prismatic('j', body, p, axis={axis}, range=(0, 0.1))\n"
    else:
        text += f"o.revolute('j', body, p, at=p.{anchor}, axis={axis}, range=(0, 1.2))\n"
    spec = run(text).spec
    assert spec is not None
    moved = link_poses(spec, {"j": 0.1})["p"]
    centre = np.array([0.0, 0, 0.41]) if lid else np.array([0.21, 0, 0.2])
    shift = moved.apply(centre) - centre
    out = shift[2] if lid else shift[0]
    assert (out < 0) == what.startswith("button")
    assert abs(out) > 0.01
