from neoworld_mjx.spec.tree import name_on_cycle, parents_first


def test_parents_come_first_and_cycles_are_named():
    assert parents_first({"a": "c", "b": None, "c": "b", "d": "b"}) == ["b", "c", "d", "a"]
    assert name_on_cycle({"a": "b", "b": "c", "c": None}) is None
    assert name_on_cycle({"a": "b"}) is None
    assert name_on_cycle({"x": "a", "a": "b", "b": "a"}) == "a"
