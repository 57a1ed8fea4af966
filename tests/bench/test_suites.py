"""The tables of suites, and the commands that they make."""

import json
import re
from pathlib import Path

import pytest

from benchmarks import __main__ as developer
from benchmarks import suites as developer_suites
from neoworld_mjx import cli
from neoworld_mjx.bench import suites


@pytest.mark.parametrize("table", [suites.SUITES, developer_suites.SUITES])
def test_every_row_names_a_function_and_options_with_help(table):
    for name, suite in table.items():
        assert callable(suite.load()), name
        assert suite.options.__doc__
        suite.options()


def test_developer_suites_are_the_ones_that_the_command_points_to():
    assert set(suites.DEVELOPER_SUITES) == set(developer_suites.SUITES)


def test_the_command_says_how_to_run_a_developer_suite(capsys):
    with pytest.raises(SystemExit, match="2"):
        cli.main(["bench", "run", "verify", "--json"])
    assert "uv run python -m benchmarks verify --json" in capsys.readouterr().err


def test_a_developer_suite_prints_one_json_object(capfd):
    arguments = ["battery", "--objects", "1", "--engine", "native", "--json"]
    with pytest.raises(SystemExit, match="0"):
        developer.main(arguments)
    (row,) = json.loads(capfd.readouterr().out)["rows"]
    assert (row["engine"], row["status"]) == ("native", "ok")


def test_the_package_imports_nothing_of_tests_and_benchmarks():
    root = Path(suites.__file__).parents[1]
    imports = re.compile(r"^\s*(from|import) (tests|benchmarks)\b", re.MULTILINE)
    modules = list(root.rglob("*.py"))
    assert len(modules) > 100
    assert [path for path in modules if imports.search(path.read_text(encoding="utf-8"))] == []
