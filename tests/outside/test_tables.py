"""Parquet files and run.json files of few bytes that stand for many rows and steps."""

import io
import json
import resource
from pathlib import Path

import arro3.io
import numpy as np
import pytest
from arro3.core import Array, RecordBatch, Table

from neoworld_mjx import cli
from neoworld_mjx.config import Config
from neoworld_mjx.errors import RunError
from neoworld_mjx.io.parquet_files import read_rows, write_rows
from neoworld_mjx.run_folder import RunFolder
from neoworld_mjx.sweeps.folder import FORMAT

SCENE = Path(__file__).parents[2] / "benchmarks/neoworld_bench/photographs/real/coffee.json"


def test_the_results_of_a_sweep_that_stand_for_a_hundred_million_rows(tmp_path, capfd):
    out, plan = tmp_path / "out", tmp_path / "plan.yaml"
    out.mkdir()
    about = {"format": FORMAT, "kind": "sweep", "finished": False}
    (out / "sweep.json").write_text(json.dumps(about))
    plan.write_text(f"scenes: [{SCENE}]\nseeds: [0]\naxes: {{refine.cem.sigma_xy: [0.01]}}\n")
    batch = RecordBatch.from_pydict({"seed": Array.from_numpy(np.zeros(1_000_000, np.int8))})
    data = io.BytesIO()
    arro3.io.write_parquet(Table.from_batches([batch] * 100), data, compression="zstd(3)")
    (out / "results.parquet").write_bytes(data.getvalue())
    assert (out / "results.parquet").stat().st_size < 2_000_000
    before = resource.getrusage(resource.RUSAGE_SELF)
    with pytest.raises(SystemExit) as ended:
        cli.main(["sweep", str(plan), "--out", str(out), "--resume"])
    after = resource.getrusage(resource.RUSAGE_SELF)
    assert ended.value.code == 2
    assert "results.parquet holds over 500000 rows" in capfd.readouterr().err
    assert (after.ru_maxrss - before.ru_maxrss) / 1000 < 500


def test_a_table_of_long_equal_texts(tmp_path):
    text = Array(["x" * 4_000_000] * 60, type=arro3.core.DataType.utf8())
    data = io.BytesIO()
    table = Table.from_batches([RecordBatch.from_pydict({"a": text})] * 3)
    arro3.io.write_parquet(table, data, compression="zstd(3)")
    path = tmp_path / "results.parquet"
    path.write_bytes(data.getvalue())
    before = resource.getrusage(resource.RUSAGE_SELF)
    with pytest.raises(RunError, match="results"):
        read_rows(path, ["a"], RunError)
    after = resource.getrusage(resource.RUSAGE_SELF)
    assert (after.ru_maxrss - before.ru_maxrss) / 1000 < 500


def test_rows_round_trip(tmp_path):
    rows = [{"a": 1, "b": "x", "c": None}, {"a": 2, "b": None, "c": 0.5}]
    path = tmp_path / "rows.parquet"
    write_rows(path, rows, {"a": int, "b": str, "c": float}, RunError)
    assert read_rows(path, ["a"], RunError) == rows


@pytest.mark.parametrize("section", ["steps", "fallbacks"])
def test_a_run_of_many_foreign_steps(tmp_path, section):
    out = tmp_path / "out"
    with RunFolder(out, Config()) as run:
        run.finish()
    data = json.loads((out / "run.json").read_text())
    if section == "steps":
        data["steps"] = {f"program/o{k}": {"inputs": {}, "outputs": {}} for k in range(20_000)}
    else:
        data["fallbacks"] = [{"step": "a", "what": str(k), "why": ""} for k in range(20_000)]
    (out / "run.json").write_text(json.dumps(data))
    with pytest.raises(RunError, match=f"{section}: .*at most 2000 items"):
        with RunFolder(out, Config(), "overwrite"):
            pass
