"""Interrupted suites: what they have made is kept, and the same command continues."""

import json
import os
import sys

import pytest
from neoworld_bench import suites
from neoworld_bench.rows import Row
from neoworld_bench.unfinished_runs import ROWS, KeptRows, unfinished

from neoworld_mjx import cli
from neoworld_mjx.config import load_config
from neoworld_mjx.errors import ConfigError, EngineError


class CountedRow(Row):
    """A row."""

    name: str
    value: float | None


@pytest.fixture(autouse=True)
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("NEOWORLD_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "bench"


def jobs(made, stop_at=None):
    def make(name):
        def rows():
            if name == stop_at:
                raise KeyboardInterrupt
            made.append(name)
            yield CountedRow(name=name, value=0.1 + len(name))
            yield CountedRow(name=name, value=None)

        return rows

    return {name: make(name) for name in ("a", "bb", "ccc")}


def run(made, stop_at=None, options=None, config=None):
    with unfinished(options or suites.Refine(), config) as folder:
        return KeptRows(folder).all(jobs(made, stop_at))


def test_an_interrupted_run_continues_and_a_finished_one_leaves_nothing(cache):
    made = []
    with pytest.raises(KeyboardInterrupt):
        run(made, stop_at="ccc")
    assert made == ["a", "bb"] and len(list(cache.iterdir())) == 1
    rows = run(made)
    assert made == ["a", "bb", "ccc"]
    assert [(row.name, row.value) for row in rows] == [
        *(("a", 1.1), ("a", None), ("bb", 2.1), ("bb", None), ("ccc", 3.1), ("ccc", None))
    ]
    assert list(cache.iterdir()) == []
    run(made)
    assert made[3:] == ["a", "bb", "ccc"]


def test_other_options_or_configurations_begin_anew(cache):
    made = []
    for options, config in (
        (suites.Refine(), None),
        (suites.Refine(seed=1), None),
        (suites.Refine(), load_config()),
        (suites.Refine(), load_config(None, {"refine": {"cem": {"population": 24}}})),
    ):
        with pytest.raises(KeyboardInterrupt):
            run(made, "bb", options, config)
    assert made == ["a"] * 4 and len(list(cache.iterdir())) == 4


def test_a_line_torn_by_a_kill_is_made_again(cache):
    made = []
    with pytest.raises(KeyboardInterrupt):
        run(made, stop_at="ccc")
    (folder,) = cache.iterdir()
    with (folder / ROWS).open("a") as file:
        file.write('["ccc", [["CountedRow", {"na')
    with pytest.raises(KeyboardInterrupt):
        run(made, stop_at="ccc")
    assert run(made)[-2].name == "ccc"
    assert made == ["a", "bb", "ccc"]


def test_an_error_before_the_first_row_leaves_no_folder(cache):
    with pytest.raises(ConfigError), unfinished(suites.Refine()):
        raise ConfigError("no such option")
    assert list(cache.iterdir()) == []


def test_a_suite_that_was_killed_takes_its_rows_over(cache, capfd, monkeypatch):
    from neoworld_bench.engines import agreement

    made, models = [], agreement._models

    def counted(name, *arguments):
        if name == "leaning" and made.count("leaning") == 0:
            made.append("leaning")
            raise KeyboardInterrupt
        made.append(name)
        return models(name, *arguments)

    monkeypatch.setattr(agreement, "_models", counted)
    monkeypatch.setattr(os, "_exit", sys.exit)  # An interrupted command ends its process.
    words = ["bench", "run", "agreement", "--scene", "stack", "leaning", "--layouts", "2", "--json"]
    with pytest.raises(SystemExit) as interrupted:
        cli.main(words)
    assert interrupted.value.code == 130
    with pytest.raises(SystemExit) as ended:
        cli.main(words)
    assert ended.value.code in (0, None)
    answer = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert [row["scene"] for row in answer["models"]] == ["stack", "leaning"]
    assert made == ["stack", "leaning", "leaning"]


@pytest.mark.parametrize(
    ("words", "package", "message"),
    [
        ("refine --set refine.optimizer=cma_es", "evosax", "evosax"),
        ("scenes --scenes tents --method ours cma_es", "evosax", "evosax"),
        ("scenes --scenes tents --method ours evosax:SNES", "evosax", "evosax"),
        ("task-success --method ours cma_es", "evosax", "evosax"),
        ("physics --objects 3 --chart out.svg", "matplotlib", "matplotlib"),
        ("pictures --lpips lpips.onnx", "onnxruntime", "onnxruntime"),
    ],
)
def test_missing_packages_are_named_before_anything_runs(
    words, package, message, cache, capfd, monkeypatch
):
    def no_row(*_):
        raise AssertionError("a row was made")

    monkeypatch.setattr(KeptRows, "rows", no_row)
    monkeypatch.setattr("neoworld_bench.methods.method_runs.run_tasks", no_row)
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.chdir(cache.parents[1])
    (cache.parents[1] / "lpips.onnx").write_bytes(b"a model")
    with pytest.raises(SystemExit) as ended:
        cli.main(["bench", "run", *words.split(), "--json"])
    assert ended.value.code == 2
    assert message in json.loads(capfd.readouterr().out)["error"]


def test_an_unknown_scene_is_refused_before_anything_runs(cache):
    for suite, options in (
        ("refine", suites.Refine(scene=("coffee", "teapot"))),
        ("photos", suites.Photos(scenes=(0, 99))),
    ):
        with pytest.raises(EngineError, match="scene"):
            suites.SUITES[suite].load()(options, load_config())
    with pytest.raises(EngineError, match="scene"):
        suites.SUITES["agreement"].load()(suites.Agreement(scene=("stack", "teapot")))
    assert not cache.exists() or list(cache.iterdir()) == []
