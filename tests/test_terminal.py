"""Output of commands in a terminal: short results, signals of programs, status line and log."""

import pytest

from neoworld_mjx.program import build

GOOD = """from neoworld_mjx.program.sdk import Object, box
o = Object("thing", "a thing")
p = o.part("body", material=o.material("oak", like="oak"))
p.add(box((0.1, 0.1, 0.1)), at=(0, 0, 0.05))
"""
DOOR = (
    GOOD
    + """q = o.part("door", material="oak")
q.add(box((0.1, 0.02, 0.1)), at=(0, {y}, 0.05))
o.revolute("hinge", p, q, at=(-0.05, -0.051, 0), axis=(0, 0, -1), range=(0, {most}))
"""
)


@pytest.mark.parametrize(
    ("program", "code", "hint"),
    [
        (
            GOOD.replace("box((0.1, 0.1, 0.1))", "box(0.1, 0.1, 0.1)"),
            "type",
            "numbers in one tuple",
        ),
        (GOOD.replace("Object, box", "Object, boks"), "type", "did you mean box?"),
        (GOOD.replace("p.add", "p.ad"), "type", "did you mean add?"),
        (GOOD.replace("neoworld_mjx.program.sdk", "sdk"), "type", "import Object, box"),
        (GOOD + "p.add(box((1, 1, 1)), rpy=(0, 0, 90))", "value", ""),
        (DOOR.format(y=-0.062, most=90), "range_large", "math.radians(90)"),
        (GOOD + "p.add(box((1,", "syntax", "bracket or a quote above is not closed"),
        (GOOD.replace("at=(0, 0, 0.05)", "rpy=(0, 10, 0)"), "degrees", "math.radians(10)"),
        (DOOR.format(y=-0.062, most=5), "degrees", "math.radians(5)"),
        (GOOD.replace("0.1))", "0.1), 0.1)"), "type", "it takes size"),
        (GOOD + "o.hinge(p)", "type", "the SDK has only"),
    ],
)
def test_common_mistakes_get_a_hint(program, code, hint):
    signals = build(program).signals
    # A door that turns by 5 rad also runs into its frame: errors come before the warning.
    signal = next(s for s in signals if s.code == code)
    assert hint in signal.hint and (signal is signals[0] or code == "degrees")
    if "rpy=(0, 0, 90)" in program:
        assert "90 degrees are 1.571" in signals[0].message
    if code == "syntax":
        assert len(signals) == 1, "a text that does not parse says nothing about its imports"
    if "box(0.1" in program:
        assert len(signals) == 1


def test_check_shows_signals_with_their_lines_and_what_was_printed(neoworld, tmp_path):
    program = tmp_path / "thing.py"
    program.write_text('print("size", 3)\n' + GOOD.replace("p.add", "p.ad"))
    code, out, _ = neoworld("check", program)
    expected = f"{program}:5:1: error type: "
    assert code == 1 and out.splitlines()[0].startswith(expected)
    assert "\n    p.ad(box((0.1, 0.1, 0.1)), at=(0, 0, 0.05))\n    hint: did you mean" in out
    code, again, _ = neoworld("check", program, "-v")
    assert code == 1 and again.splitlines()[0] == out.splitlines()[0]
    code, _, message = neoworld("export", program, "--out", tmp_path / "out")
    assert code == 2 and "p.ad" not in message and "did you mean" not in message
    assert not (tmp_path / "out").exists()
    program.write_text('print("size", 3)\n' + GOOD)
    code, out, _ = neoworld("check", program)
    assert code == 0 and "unknown" not in out
    assert out.splitlines()[0] == "thing.py printed: size 3"
    assert "valid: thing passes all" in out and len(out.splitlines()) <= 5
