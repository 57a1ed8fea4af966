"""Objects that move: their kind, the reason, and the order in which they are listed."""

import math

import pytest

from neoworld_mjx.measure import SceneMeasure, unstable_objects
from neoworld_mjx.measure.unstable import FALLS_M, phrases
from neoworld_mjx.spec import Box
from tests.support import scenes

NAMES = ("a", "b", "c")


def scene(**fields):
    """Three blocks on a table; `fields` are those of `b`."""
    block = {name: scenes.single(name, (Box(size=(0.1, 0.1, 0.1)), (0, 0, 0))) for name in NAMES}
    rows = [(block[n], (0, 0.2 * k), 0.0, fields if n == "b" else {}) for k, n in enumerate(NAMES)]
    return scenes.on_table(*rows)


def measure(drift=(), tilt=(), drop=(), depths=()):
    whole = lambda given: dict.fromkeys(NAMES, 0.0) | dict(given)
    return SceneMeasure(
        objects=4, movable=3, s_pen=0, max_depth_m=0.0, settled_depth_m=0.0, s_stab=False,
        max_drift_m=0.0, max_tilt_deg=0.0, duration_s=2.0, depths_m=dict(depths),
        drift_m=whole(drift), tilt_deg=whole(tilt), drop_m=whole(drop),
    )  # fmt: skip


def named(entries):
    return {entry.name: (entry.kind, entry.why) for entry in entries}


def test_a_motion_at_its_bound_is_over_it():
    assert unstable_objects(scene(), measure({"a": 0.00999}, {"b": 4.99})) == ()
    found = unstable_objects(scene(), measure({"a": 0.01}, {"b": 5.0}))
    assert [(e.name, e.kind) for e in found] == [("b", "topples"), ("a", "slides")]
    given = measure({"a": 0.02}, {"b": 8.0})
    assert unstable_objects(scene(), given, max_drift=0.021, max_tilt=8.1) == ()
    assert len(unstable_objects(scene(), given, max_drift=0.02, max_tilt=8.0)) == 2


def test_a_descent_of_centimeters_is_a_fall():
    found = named(
        unstable_objects(scene(), measure({"a": 0.1, "b": 0.1}, {"b": 9.0}, {"a": FALLS_M}))
    )
    assert found["a"][0] == "slides" and found["b"][0] == "topples"
    drop = {"a": FALLS_M + 1e-6, "b": 0.5}
    found = unstable_objects(scene(), measure({"a": 0.1, "b": 0.1}, {"b": 9.0}, drop))
    assert [(e.name, e.kind, e.drop_m) for e in found] == [
        ("b", "falls", 0.5), ("a", "falls", FALLS_M + 1e-6)
    ]  # fmt: skip


@pytest.mark.parametrize("field", ["tilt", "drop"])
@pytest.mark.parametrize("value", [math.inf, math.nan])
def test_a_motion_that_is_not_finite_diverges_and_comes_first(field, value):
    given = {"drift": {"a": 1.0, "b": 1.0}, "drop": {"a": 1.0}}
    given[field] = {**given.get(field, {}), "b": value}
    found = unstable_objects(scene(), measure(**given))
    assert [(e.name, e.kind) for e in found] == [("b", "diverges"), ("a", "falls")]


def test_the_reason_is_the_first_that_applies():
    moved = measure({"b": 0.1})
    assert named(unstable_objects(scene(), moved))["b"][1] == "it does not rest on table"
    fallen = measure({"b": 0.1}, drop={"b": 0.1})
    why = named(unstable_objects(scene(), fallen))["b"][1]
    assert why == "table is not below it, or does not hold it"
    lost = measure({"b": math.inf}, drop={"b": math.inf})
    assert named(unstable_objects(scene(), lost))["b"] == ("diverges", "it does not rest on table")
    leaning = named(unstable_objects(scene(relation="leaning"), moved))["b"][1]
    assert leaning == "it stands on table, and nothing that it leans against holds it"
    (entry,) = unstable_objects(scene(relation="attached"), moved)
    assert entry.why == "it is attached to table, but not fastened there" and not entry.held
    on_a = scene(parent="a", z=0.1)
    assert named(unstable_objects(on_a, measure({"a": 0.1, "b": 0.1})))["b"][1] == (
        "a, which supports it, moves"
    )
    on_free = named(unstable_objects(scene(parent="a", relation="attached", z=0.1), moved))
    assert on_free["b"][1] == "it is attached to a, which is free to move, but not fastened there"


def test_the_deepest_overlap_is_named_if_it_is_over_a_millimeter():
    deep = measure({"b": 0.1}, depths={"a|b": 0.002, "b|c": 0.0034, "a|c": 0.9})
    assert named(unstable_objects(scene(), deep))["b"][1] == "it initially penetrates c by 3.4 mm"
    other = measure({"b": 0.1}, depths={"a|b": 0.002})
    assert named(unstable_objects(scene(), other))["b"][1] == "it initially penetrates a by 2.0 mm"
    shallow = measure({"b": 0.1}, depths={"a|b": 0.001})
    assert named(unstable_objects(scene(), shallow))["b"][1] == "it does not rest on table"


def test_each_kind_has_its_phrase():
    given = measure({"a": 0.0123, "b": 1.7, "c": 0.1}, {"c": 12.4}, {"b": 1.637})
    assert phrases(unstable_objects(scene(), given)) == (
        "b falls 1.6 m: table is not below it, or does not hold it; c topples by 12 deg: it does "
        "not rest on table; a moves 12 mm: it does not rest on table"
    )
    (diverged,) = unstable_objects(scene(), measure({"a": math.nan}, {"a": math.inf}))
    assert diverged.phrase().startswith("a makes the simulation diverge: ")
