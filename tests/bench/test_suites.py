"""Tables of suites and their commands."""

import json
import re
from pathlib import Path

import pytest
from neoworld_bench import suites
from neoworld_bench.bench_commands import check_numbers

from neoworld_mjx import cli


def test_every_suite_has_a_function_and_documented_options():
    for name, suite in suites.SUITES.items():
        assert callable(suite.load()), name
        assert suite.options.__doc__
        suite.options()


def test_packages_do_not_import_tests_or_benchmarks():
    imports = re.compile(r"^\s*(from|import) (tests|benchmarks)\b", re.MULTILINE)
    roots = (Path(cli.__file__).parent, Path(suites.__file__).parent)
    modules = [path for root in roots for path in root.rglob("*.py")]
    assert len(modules) > 100
    assert [path for path in modules if imports.search(path.read_text(encoding="utf-8"))] == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("engines --population 64 0", "--population must be 1 or more, got 0"),
        ("engines --duration 0", "--duration must be above 0, got 0.0"),
        ("engines --budget nan", "--budget must be above 0, got nan"),
        ("scenes --starts 0", "--starts must be 1 or more, got 0"),
        ("scenes --workers -1", "--workers must be 0 or more, got -1"),
    ],
)
def test_options_out_of_range_are_refused(words, message, capfd):
    with pytest.raises(SystemExit) as ended:
        cli.main(["bench", "run", *words.split(), "--json"])
    assert ended.value.code == 2
    assert json.loads(capfd.readouterr().out)["error"] == message


def test_scenes_of_photos_are_counted_from_0():
    check_numbers(suites.Photos(scenes=(0,)))
