"""The table of mutations covers whole packages, and names tests and lines that exist."""

import ast

import pytest
import yaml

from benchmarks.mutation import NAMED_BY, ROOT, TABLE

CONTENT = yaml.safe_load(TABLE.read_text())
PACKAGES = ("refinement/*.py", "physics/placed*.py", "measure/*.py")


def test_every_module_of_the_measured_packages_is_mutated():
    paths = [path for pattern in PACKAGES for path in (ROOT / "neoworld_mjx").glob(pattern)]
    names = {str(path.relative_to(ROOT)) for path in paths if path.name != "__init__.py"}
    assert len(names) > 30
    assert names <= CONTENT["modules"].keys(), sorted(names - CONTENT["modules"].keys())


@pytest.mark.parametrize("module", CONTENT["modules"])
def test_a_module_and_the_tests_that_hold_it_exist(module):
    assert (ROOT / module).is_file()
    for test in CONTENT["modules"][module]:
        file, _, name = test.partition("::")
        top = ast.parse((ROOT / file).read_text()).body
        defined = {node.name for node in top if isinstance(node, ast.FunctionDef | ast.ClassDef)}
        assert not name or name in defined, test


@pytest.mark.parametrize("entry", CONTENT["explained"], ids=lambda entry: entry["line"][:40])
def test_an_explained_mutant_is_one_of_the_present_code(entry):
    assert entry["why"] and entry["module"] in CONTENT["modules"]
    lines = [line.strip() for line in (ROOT / entry["module"]).read_text().splitlines()]
    assert entry["line"] in lines and all(entry[key] for key in NAMED_BY)
