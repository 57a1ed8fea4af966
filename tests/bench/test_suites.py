"""Tables of suites and their commands."""

import json
import re
from pathlib import Path

import pytest
from neoworld_bench import suites

from benchmarks import __main__ as developer
from benchmarks import suites as developer_suites
from neoworld_mjx import cli


@pytest.mark.parametrize("table", [suites.SUITES, developer_suites.SUITES])
def test_every_suite_has_a_function_and_documented_options(table):
    for name, suite in table.items():
        assert callable(suite.load()), name
        assert suite.options.__doc__
        suite.options()


def test_developer_suites_match_the_list_of_the_command():
    assert set(suites.DEVELOPER_SUITES) == set(developer_suites.SUITES)


def test_command_explains_how_to_run_developer_suites(capsys):
    with pytest.raises(SystemExit, match="2"):
        cli.main(["bench", "run", "verify", "--json"])
    assert "uv run python -m benchmarks verify --json" in capsys.readouterr().err


def test_developer_suite_prints_one_json_object(capfd):
    arguments = ["battery", "--objects", "1", "--engine", "native", "--json"]
    with pytest.raises(SystemExit, match="0"):
        developer.main(arguments)
    (row,) = json.loads(capfd.readouterr().out)["rows"]
    assert (row["engine"], row["status"]) == ("native", "ok")


def test_packages_do_not_import_tests_or_developer_suites():
    imports = re.compile(r"^\s*(from|import) (tests|benchmarks)\b", re.MULTILINE)
    roots = (Path(cli.__file__).parent, Path(suites.__file__).parent)
    modules = [path for root in roots for path in root.rglob("*.py")]
    assert len(modules) > 100
    assert [path for path in modules if imports.search(path.read_text(encoding="utf-8"))] == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("physics --population 64 0", "--population must be 1 or more, got 0"),
        ("physics --duration 0", "--duration must be above 0, got 0.0"),
        ("physics --budget nan", "--budget must be above 0, got nan"),
        ("scenes --starts 0", "--starts must be 1 or more, got 0"),
        ("scenes --workers -1", "--workers must be 0 or more, got -1"),
        ("tasks --directions -1", "--directions must be 0 or more, got -1"),
    ],
)
def test_options_out_of_range_are_refused(words, message, capfd):
    with pytest.raises(SystemExit) as ended:
        cli.main(["bench", "run", *words.split(), "--json"])
    assert ended.value.code == 2
    assert json.loads(capfd.readouterr().out)["error"] == message
