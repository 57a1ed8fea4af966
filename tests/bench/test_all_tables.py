"""All tables by one command: made once, and compared with earlier ones."""

import json
import shlex

import pytest
import tyro
from neoworld_bench import all_tables
from neoworld_bench.bench_commands import SuiteChoice

from neoworld_mjx import cli
from neoworld_mjx.errors import RunError


@pytest.fixture
def tiny(monkeypatch):
    words = "tasks --task cube_on_cube --starts 1 --method truth"
    monkeypatch.setattr(all_tables, "TABLES", {"success": words})
    monkeypatch.setattr(all_tables, "commit", lambda: "0123456789")
    monkeypatch.setattr("neoworld_bench.machine.commit", lambda: "0123456789")


def test_a_table_is_made_once_by_its_command(tiny, tmp_path):
    made = all_tables.run_tables(tmp_path, (), 1, None)
    assert made == {"files": ["success.json"], "changes": []}
    file = tmp_path / "success.json"
    result = json.loads(file.read_text())
    assert result["methods"]["truth"]["success_on_truth"] == 1.0 and result["n"] == 1
    assert "--task cube_on_cube" in result["command"]
    assert {"device", "date", "machine"} <= set(result)
    before = file.stat().st_mtime_ns
    all_tables.run_tables(tmp_path, ("success",), 1, None)
    assert file.stat().st_mtime_ns == before
    file.write_text(json.dumps({**result, "commit": "of another day"}))
    all_tables.run_tables(tmp_path, (), 1, None)
    assert json.loads(file.read_text())["commit"] == "0123456789"
    file.write_text("[]")
    with pytest.raises(RunError, match=r"success\.json is no JSON object"):
        all_tables.run_tables(tmp_path, (), 1, None)


def test_words_of_all_tables_are_commands():
    for name, words in {**all_tables.TABLES, **all_tables.GPU_TABLES}.items():
        command = tyro.cli(SuiteChoice, args=[*shlex.split(words), "--json"])
        assert command.json and hasattr(command, "run"), name


def test_figures_whose_intervals_do_not_overlap_are_listed():
    def result(share, low, high, error):
        figures = {"valid_rate": share, "valid_rate_interval": [low, high]}
        figures |= {"xy_error_m": error, "xy_error_m_interval": [error, error]}
        return {"n": 3, "methods": {"ours": {**figures, "p_pen_interval": [None, None]}}}

    before, after = result(0.5, 0.4, 0.6, 0.01), result(0.8, 0.55, 0.9, 0.02)
    assert list(all_tables.differences(before, after)) == ["methods: ours: xy_error_m 0.01 -> 0.02"]
    assert list(all_tables.differences(before, before)) == []


def test_an_unknown_table_is_refused(tmp_path, capfd):
    with pytest.raises(SystemExit):
        cli.main(["bench", "run", "all", "--out", str(tmp_path), "--tables", "scene", "--json"])
    assert (
        "tables: got 'scene', valid are: examples, scenes,"
        in json.loads(capfd.readouterr().out)["error"]
    )
    assert list(tmp_path.iterdir()) == []
