"""Named constants of programs: which numbers they are, and edits of a literal alone."""

import difflib

import pytest

from neoworld_mjx.program.named_constants import named_constants, with_value
from neoworld_mjx.templates import templates

SHELF = '''"""Ein Regal, 60 cm breit: größer als 1.5 Teller."""
from neoworld_mjx.program.sdk import Object, box

X, Y, Z = 0.30, 0.60, 0.82  # Z = 0.82 from the floor
WALL: float = 0.018
BOARDS = 3
SHIFT = -0.02
NAME, HALF = "ü", 0.05;  TWICE = 2 * HALF
DEPTH = 0.3
DEPTH = DEPTH - WALL

def board(z):
    THICK = 0.02
    return box((X, Y, THICK)).moved((0, 0, z))

shelf = Object("shelf")
body = shelf.part("body", material="oak")
body.add(box((DEPTH, Y, Z)), by="bottom")
'''


def test_constants_are_floats_that_are_assigned_once_at_top_level():
    found = {c.name: c.value for c in named_constants(SHELF)}
    assert found == {"X": 0.3, "Y": 0.6, "Z": 0.82, "WALL": 0.018, "HALF": 0.05}


def test_a_template_states_the_range_of_its_parameters():
    for template in templates().values():
        constants = {c.name: c for c in named_constants(template.text)}
        for name in ("depth", "width", "height"):
            parameter = template.parameters[name]
            assert (constants[name].low, constants[name].high) == (parameter.low, parameter.high)
            assert constants[name].within(1e3) == parameter.high


@pytest.mark.parametrize("name", ["X", "Y", "Z", "WALL", "HALF"])
def test_an_edit_replaces_the_literal_alone(name):
    constant = next(c for c in named_constants(SHELF) if c.name == name)
    text = with_value(SHELF, constant, 1.1 * constant.value)
    changed = [line for line in difflib.ndiff(SHELF.split("\n"), text.split("\n"))
               if line[0] in "+-"]  # fmt: skip
    assert len(changed) == 2
    after = {c.name: c.value for c in named_constants(text)}
    before = {c.name: c.value for c in named_constants(SHELF)}
    assert after == before | {name: pytest.approx(1.1 * constant.value, rel=1e-3)}
    literal = SHELF.split("\n")[constant.line].encode()[constant.start : constant.end].decode()
    line = SHELF.split("\n")[constant.line]
    number = repr(after[name])
    assert text.split("\n")[constant.line] == line.replace(f"{literal}", number, 1)


def test_edits_of_another_text_or_to_no_length_are_refused():
    constant = next(c for c in named_constants(SHELF) if c.name == "Z")
    with pytest.raises(ValueError, match="does not hold Z"):
        with_value(SHELF.replace("0.82", "0.90", 1), constant, 0.5)
    with pytest.raises(ValueError, match="does not hold Z"):
        with_value("", constant, 0.5)
    for value in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="positive"):
            with_value(SHELF, constant, value)
