"""Benchmark pages and the figures that they are generated from."""

import json
import re

import pytest
from neoworld_bench import suites
from pydantic import ValidationError

from benchmarks import page
from benchmarks import suites as developer
from benchmarks.figure import FIGURES, ROOT, Figure, code_of, fingerprint, recorded
from neoworld_mjx import cli

NAMES = sorted(path.stem for path in FIGURES.iterdir() if path.stem != "page")


def test_pages_and_tables_match_the_figures():
    pages = page.pages()
    written = {path: (ROOT / path).read_text(encoding="utf-8") for path in pages}
    assert written == pages, "stale: run `uv run python -m benchmarks.page`"
    folder = {path.name for path in (ROOT / "docs" / "benchmarks").iterdir()}
    assert folder == {path.name for path in written if path.parent.name == "benchmarks"}


MEASURED = re.compile(
    r"AMD EPYC|Intel Xeon|\bH[12]00s?\b|\(n = \d|, n = \d|\d % \(\d+ to \d+\)|95 % interval -?[.\d]"
    r"|\d+ m?s of processor time (for|on|a)\b"
)
"""Devices, sizes and intervals, which only figures state."""
GENERATED = re.compile(r"<!-- [a-z_]+ -->\n.*?<!-- end -->", re.S)


def test_no_page_states_a_measurement_by_hand():
    """A figure in a text goes stale unnoticed: it belongs into benchmarks/figures."""
    whole = {ROOT / path for path in page.pages() if path.parent.name == "benchmarks"}
    whole |= {ROOT / "docs/benchmarks.md", ROOT / "docs/results.md"}
    whole |= {ROOT / "docs/differences-from-the-paper.md"}  # by neoworld_mjx.config, of figures
    found = []
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        if path not in whole:
            text = GENERATED.sub("", path.read_text(encoding="utf-8"))
            lines = filter(MEASURED.search, text.splitlines())
            found += [f"{path.relative_to(ROOT)}: {line.strip()}" for line in lines]
    assert not found


def test_every_figure_is_on_a_page():
    contents = page.read_contents()
    shown = [name for each in contents.pages for name in each.figures]
    unmeasured = set(contents.swept) - set(NAMES)
    assert sorted(shown) == sorted([*NAMES, *unmeasured])


def test_code_is_what_runs(tmp_path):
    text = (
        '"""Module."""\n\nX = "a # b"  # a comment\n\n\ndef f():\n    """Return."""\n    return X\n'
    )
    code = 'X = "a # b"\ndef f():\n    return X'
    assert code_of("a.py", text.encode()) == code_of("a.py", code.encode()) == code
    assert code_of("a.py", text.replace("a # b", "a # c").encode()) != code
    assert code_of("a.md", b"ask") != code_of("a.md", b"ask twice")


def test_a_fingerprint_covers_names_and_contents(tmp_path):
    def digest(**files):
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        (folder / "below").mkdir(parents=True)
        for name, text in files.items():
            (folder / "below" / f"{name}.py").write_text(text)
        return fingerprint(folder)

    first = digest(a="X = 1\n", b="")
    assert first == digest(a="# one\nX = 1\n", b="")
    assert len({first, digest(a="X = 2\n", b=""), digest(c="X = 1\n", b=""), digest(b="")}) == 4


def test_every_figure_names_code_that_exists():
    for name in NAMES:
        figure = page.read_figure(name)
        assert all((ROOT / path).exists() for path in figure.code), name
        assert figure.date > "2026"


def test_an_old_figure_is_marked_wherever_its_values_are(monkeypatch):
    old = page.read_figure("examples").model_copy(
        update={"commit": "abc1234", "code": {"neoworld_mjx/refinement": "0" * 12}}
    )
    new = old.model_copy(update={"code": {}})
    table = "| a | b |\n|---|---|\n| drift | {examples/coffee/drift, mm} mm |\n| c | d |"
    value = old.cell("coffee", "drift, mm")
    monkeypatch.setattr(page, "read_figure", lambda name: old)
    assert page.filled(table).splitlines()[2:] == [
        f"| drift\\* | {value} mm |",
        "| c | d |",
        "",
        "\\* Recorded with an older version: examples (commit abc1234).",
    ]
    assert "changed." in page.markdown(old) and "`neoworld_mjx/refinement`" in page.markdown(old)
    monkeypatch.setattr(page, "read_figure", lambda name: new)
    assert page.filled(table).splitlines()[2] == f"| drift | {value} mm |"
    assert "older version" not in page.filled(table) + page.markdown(new)


@pytest.mark.parametrize(
    ("row", "column", "message"),
    [
        ("tea", "objects", "0 rows for tea/objects; rows begin with coffee, drawers, microwave"),
        ("coffee", "spoons", "columns: example, responses"),
    ],
)
def test_a_reference_to_nothing_is_refused(row, column, message):
    with pytest.raises(KeyError, match=message):
        page.filled(f"| a | {{examples/{row}/{column}}} |")


def test_a_row_is_named_by_as_many_cells_as_it_needs():
    figure = page.read_figure("rollouts_h200")
    assert figure.cell("warp, 6, 4 096", "with early stop") == "7 154"
    with pytest.raises(KeyError, match="2 rows for warp, 6/"):
        figure.cell("warp, 6", "with early stop")


@pytest.mark.parametrize("name", NAMES)
def test_pages_show_every_figure_with_device_and_n(name):
    figure = page.read_figure(name)
    pages = [text for path, text in page.pages().items() if path.parent.name == "benchmarks"]
    assert sum(f"## {figure.title}\n" in text for text in pages) == 1
    assert figure.device and figure.n and figure.command
    assert figure.suite is None or figure.suite in {*suites.SUITES, *developer.SUITES}
    assert all(len(row) == len(figure.columns) for row in figure.rows)


def test_figure_without_a_device_is_refused():
    with pytest.raises(ValidationError, match="device"):
        Figure.model_validate({"title": "a", "command": "b", "n": "1", "date": "2026-01-01"})


def test_output_of_a_suite_is_a_valid_figure(capfd):
    words = ["bench", "run", "agreement", "--scene", "stack", "--layouts", "2", "--json"]
    with pytest.raises(SystemExit):
        cli.main(words)
    answer = json.loads(capfd.readouterr().out)
    figure = recorded(answer, None, ["neoworld_mjx/physics"])
    assert figure.changed == [] and figure.commit == answer["commit"]
    assert figure.command == "neoworld bench run agreement --scene stack --layouts 2 --json"
    assert "cores" in figure.device and "mujoco" in figure.software
    assert "| stack |" in page.markdown(figure)
    known = figure.model_copy(
        update={"title": "Agreement", "keys": ["scene"], "columns": ["scene"], "rows": []}
    )
    again = recorded(answer, known, [])
    assert (again.title, again.rows, again.code) == ("Agreement", [["stack"]], figure.code)
    with pytest.raises(ValueError, match="Agreement: its table was written by hand"):
        recorded(answer, known.model_copy(update={"keys": []}), [])
