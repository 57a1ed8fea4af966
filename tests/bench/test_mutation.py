"""Every module of the mutated packages has tests."""

from benchmarks.mutation import ROOT, Mutation, direct_tests, modules_of


def test_every_mutated_module_has_tests():
    modules = modules_of(Mutation().modules)
    assert "neoworld_mjx/refinement/cem.py" in modules
    assert direct_tests("neoworld_mjx/refinement/cem.py") == "tests/refinement/test_cem.py"
    assert all((ROOT / direct_tests(module)).exists() for module in modules)
