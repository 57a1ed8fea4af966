"""Arguments of programs: what is refused, in which words, and what is only warned of."""

import math

import pytest

from neoworld_mjx.program import session as validate
from neoworld_mjx.program.session import LimitExceeded, Session, use_session


@pytest.mark.parametrize(
    ("angle", "warned"),
    [(3, False), (-3, False), (3.5, False), (4, True), (-5.0, True), (12, True), (12.5, False)],
)
def test_whole_numbers_of_radians_above_pi_are_probably_degrees(angle, warned):
    session = Session(line=7)
    with use_session(session):
        assert validate.rotation((0.1, angle, -0.2), "rpy") == (0.1, angle, -0.2)
    assert [warning.code for warning in session.warnings] == ["degrees"] * warned
    for warning in session.warnings:
        assert warning.line == 7 and warning.severity == "warning"
        assert warning.message.startswith(f"rpy: {angle:g} radians are {math.degrees(angle):.0f} ")
        assert f"math.radians({angle:g})" in (warning.hint or "")


@pytest.mark.parametrize("degrees", [13, 90, -45, 180.0])
def test_large_whole_numbers_of_radians_are_refused(degrees):
    with pytest.raises(ValueError, match=rf"rpy: .*{math.radians(degrees):.4g}, math.radians"):
        validate.rotation((0, 0, degrees), "rpy")
    # Not a whole number: a turn by more than two rounds.
    assert validate.rotation((0, 0, 13.5), "rpy") == (0, 0, 13.5)
    with pytest.raises(ValueError, match="within"):
        validate.rotation((0, 0, 200.5), "rpy")


REFUSED = [
    (validate.number, (True, "a"), "a must be a number, got True"),
    (validate.number, ("1", "a"), "a must be a number, got '1'"),
    (validate.number, (math.nan, "a"), "a must be finite, got nan"),
    (validate.number, (-1.1e6, "a"), "a must lie within"),
    (validate.number, (10**40, "a"), "got an integer of 133 bits"),
    (validate.length, (0, "a"), "a must be a positive length in metres, at least 1e-05, got 0.0"),
    (validate.length, (9e-6, "a"), "at least 1e-05"),
    (validate.length, (100.5, "a"), "within"),
    (validate.sequence, ("ab", "a", 2, 2), "a must be a list or tuple, got 'ab'"),
    (validate.sequence, ((1, 2), "a", 3, 3), "a must have 3 entries, got 2"),
    (validate.sequence, ([1] * 9, "a", 3, 8), "a must have 3 to 8 entries, got 9"),
    (validate.vector, ((0, 0, 101), "a"), "within"),
    (validate.lengths, ((1, 1, 0), "a"), "a must be a positive length"),
    (validate.points, (((0, 0), (0, "x")), "a", 2, 4), r"a\[1\] must be a number, got 'x'"),
    (validate.integer, (2.0, "a", 1, 3), "a must be an integer, got 2.0"),
    (validate.integer, (True, "a", 0, 3), "a must be an integer, got True"),
    (validate.integer, (4, "a", 1, 3), "a must lie between 1 and 3, got 4"),
    (validate.integer, (0, "a", 1, 3), "a must lie between 1 and 3, got 0"),
    (validate.name, ("1st", "a"), "a must start with a letter"),
    (validate.name, (3, "a"), "a must be a string, got 3"),
    (validate.unused, ("Lid", "part", ("body", "lid")), "part 'lid' exists already"),
    (validate.text, ("a\nb", "a"), "a must be one line of at most 200 characters"),
    (validate.text, ("a" * 201, "a"), "at most 200"),
    (validate.colour, ((0.1, 1.1, 0), "a"), "a must be red, green, blue between 0 and 1"),
    (validate.colour, ((0.1, -0.1, 0), "a"), "between 0 and 1"),
]


@pytest.mark.parametrize(("check", "arguments", "message"), REFUSED)
def test_a_wrong_argument_is_named_with_its_value(check, arguments, message):
    with pytest.raises((TypeError, ValueError), match=message):
        check(*arguments)


@pytest.mark.parametrize(
    ("check", "arguments", "value"),
    [
        (validate.number, (-1e6, "a"), -1e6),
        (validate.length, (1e-5, "a"), 1e-5),
        (validate.length, (100, "a"), 100.0),
        (validate.points, (((0, 1), [2, 100]), "a", 2, 2), ((0, 1), (2, 100))),
        (validate.lengths, ([1, 2, 3], "a"), (1, 2, 3)),
        (validate.integer, (1, "a", 1, 3), 1),
        (validate.integer, (3, "a", 1, 3), 3),
        (validate.name, ("Lid_2", "a"), "Lid_2"),
        (validate.text, ("a" * 200, "a"), "a" * 200),
        (validate.colour, ((0, 1, 0.5), "a"), (0, 1, 0.5)),
    ],
)
def test_the_bounds_themselves_are_allowed(check, arguments, value):
    assert check(*arguments) == value


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ([1] * 7, "list of 7 items"),
        ((1, 2, 3, 4, 5, 6), "(1, 2, 3, 4, 5, 6)"),
        ([[["x"]]], "[[list of 1 items]]"),
        ("x" * 60, repr("x" * 60)),
        ("x" * 61, repr("x" * 57 + "...")),
        (2**100, "an integer of 101 bits"),
        (2**100 - 1, str(2**100 - 1)),
        (None, "None"),
        ({}, "dict"),
    ],
)
def test_values_in_messages_are_short(value, expected):
    assert validate.formatted(value) == expected


def test_a_session_that_exceeded_a_limit_stays_ended():
    session = Session()
    session.use("geoms", 3, 5)
    session.use("geoms", 2, 5)
    session.use("parts", 5, 5)
    with pytest.raises(LimitExceeded, match="the object needs over 5 geoms"):
        session.use("geoms", 1, 5)
    for _ in range(2):
        with pytest.raises(LimitExceeded, match="geoms"), session.call():
            pass
    with pytest.raises(LimitExceeded, match="over 5 geoms"):
        session.stop("other", "another reason")


def test_warnings_are_bounded_and_need_a_session():
    validate.warn("degrees", "outside of a session", "")
    session = Session()
    with use_session(session):
        for k in range(30):
            validate.warn("degrees", str(k), "")
    assert [warning.message for warning in session.warnings] == [str(k) for k in range(20)]
    assert validate.current_line() is None and validate.current().warnings == []
