"""Benchmark pages and the figures that they are generated from."""

import json

import pytest
from neoworld_bench import suites
from pydantic import ValidationError

from benchmarks import page
from benchmarks import suites as developer
from neoworld_mjx import cli

NAMES = sorted(path.stem for path in page.FIGURES.iterdir() if path.stem != "page")


def test_pages_match_the_figures():
    written = {path: (page.DOCS / path).read_text(encoding="utf-8") for path in page.pages()}
    assert written == page.pages(), "stale: run `uv run python -m benchmarks.page`"
    folder = {path.name for path in (page.DOCS / "benchmarks").iterdir()}
    assert folder == {path.name for path in written} - {"benchmarks.md"}


@pytest.mark.parametrize("name", NAMES)
def test_pages_show_every_figure_with_device_and_n(name):
    figure = page.read_figure(name)
    assert (
        sum(
            f"## {figure.title}\n" in text
            for path, text in page.pages().items()
            if path.parent.name
        )
        == 1
    )
    assert figure.device and figure.n and figure.command
    assert figure.suite is None or figure.suite in {*suites.SUITES, *developer.SUITES}
    assert all(len(row) == len(figure.columns) for row in figure.rows)


def test_figure_without_a_device_is_refused():
    with pytest.raises(ValidationError, match="device"):
        page.Figure.model_validate({"title": "a", "command": "b", "n": "1", "date": "2026-01-01"})


def test_output_of_a_suite_is_a_valid_figure(capfd):
    words = ["bench", "run", "agreement", "--scene", "stack", "--layouts", "2", "--json"]
    with pytest.raises(SystemExit):
        cli.main(words)
    answer = json.loads(capfd.readouterr().out)
    figure = page.from_result(answer)
    assert figure.command == "neoworld bench run agreement --scene stack --layouts 2 --json"
    assert "cores" in figure.device and "mujoco" in figure.software
    assert "| stack |" in page.markdown(figure)
