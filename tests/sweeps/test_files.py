"""Files of a sweep: rows and iterations, tables, and a figure."""

import csv
import io
from xml.etree import ElementTree as ET

import arro3.io
import pytest
from arro3.core import Table

from neoworld_mjx.errors import RunError
from neoworld_mjx.sweeps.figure import MAX_LINES, draw
from neoworld_mjx.sweeps.folder import SweepFolder, read_rows
from neoworld_mjx.sweeps.result import comma_separated, result_of

SIGMA, DRIFT = "refine.cem.sigma_xy", "refine.reward.w_drift"


def run(point, seed, sigma, drift, reward=0.5, **more):
    steps = [
        {"iteration": t + 1, "rollouts": 8 * (t + 1), "best": reward - 0.1 / (t + 1),
         "mean": 0.0, "valid": 0.5,
         "d_pen_m": 1e-3, "d_drift": 0.2, "s_sem": 0.7, "prior": 0.0}
        for t in range(2 + seed)
    ]  # fmt: skip
    row = {"scene": "two", "point": point, "seed": seed, SIGMA: sigma, DRIFT: drift}
    row |= {"passed": seed == 0, "valid": True, "reward": reward, "d_drift": 0.1 * drift}
    return row | {"s_sem": 0.8, "fingerprint": f"{point}{seed}", "history": steps} | more


ROWS = [
    run(f"s {sigma}, d {drift}", seed, sigma, drift)
    for sigma in (0.03, 0.06)
    for drift in (0.5, 1.0)
    for seed in (0, 1)
]


def result(rows, kind="sweep"):
    points = [{"label": label} for label in dict.fromkeys(row["point"] for row in rows)]
    return result_of(rows, {"kind": kind, "commit": None, "points": points})


def test_a_folder_keeps_rows_and_iterations_with_further_terms(tmp_path):
    rows = [
        row
        | {"term_upright": 0.5, "history": [step | {"upright": 0.25} for step in row["history"]]}
        for row in ROWS
    ]
    with SweepFolder(tmp_path / "out", "sweep", resume=False, overwrite=False) as folder:
        for row in rows:
            folder.add(row)
        folder.write_tables(rows, [SIGMA, DRIFT])
    with SweepFolder(tmp_path / "out", "sweep", resume=True, overwrite=False) as again:
        for old, new in zip(rows, again.rows, strict=True):
            assert {name: new[name] for name in old} == old
    table = Table(arro3.io.read_parquet(tmp_path / "out" / "results.parquet").read_all())
    assert table["term_upright"].to_pylist() == [0.5] * len(rows)
    kept = tmp_path / "out" / "rows.jsonl"
    kept.write_text(kept.read_text()[:-9])  # As a killed process leaves it.
    assert read_rows(tmp_path / "out") == rows[:-1]
    for text, message in (('{"scene": 1}', "scene"), ("[" * 10_000, "JSON"), ("x", "JSON")):
        kept.write_text(f"{text}\n")
        with pytest.raises(RunError, match=rf"rows\.jsonl is damaged: .*{message}.*--overwrite"):
            read_rows(tmp_path / "out")
    with SweepFolder(tmp_path / "out", "sweep", resume=False, overwrite=True):
        names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == [".lock", "sweep.json"]


def test_the_table_in_numbers():
    first, *_, last = csv.DictReader(io.StringIO(comma_separated(result(ROWS).points)))
    assert first["point"] == "s 0.03, d 0.5" and last["n"] == "2"
    assert float(first["passed"]) == 0.5 and float(last["d_drift"]) == pytest.approx(0.1)


def test_differences_are_paired_and_signed():
    rows = [run("base", seed, 1, 1, reward=0.1 * seed) for seed in range(3)]
    rows += [run("more", seed, 1, 1, reward=0.1 * seed + 0.4) for seed in range(3)]
    found = result(rows, "ablation")
    (more,) = found.differences
    assert (more["point"], more["n"]) == ("more", 3)
    # The differences are equal, although the rewards of the seeds are not.
    assert [more["reward"][name] for name in ("mean", "low", "high")] == pytest.approx([0.4] * 3)
    assert "## Differences from the base" in found.table and "+0.400 [" in found.table
    # Agreement of a few pairs is no certainty.
    assert more["passed"]["low"] < more["passed"]["mean"] == 0 < more["passed"]["high"]


def test_a_figure_shows_points_and_axes():
    drawn = draw(ROWS, [SIGMA, DRIFT])
    assert drawn is not None and drawn == draw(ROWS, [SIGMA, DRIFT])
    text = "\n".join(part.text or "" for part in ET.fromstring(drawn).iter())
    for label in ("s 0.06, d 1.0", "passed, %", "sigma_xy", "w_drift 0.5", "S_sem"):
        assert label in text, label
    one = "".join(ET.fromstring(draw(ROWS[:4], [SIGMA, DRIFT])).itertext())
    assert "w_drift" in one and "sigma_xy" not in one
    assert "passed, %" not in draw(ROWS[:1], [SIGMA, DRIFT])
    many = [run(f"point {k}", 0, 0.1, float(k), reward=k / 20) for k in range(MAX_LINES + 3)]
    text = draw(many, [DRIFT])
    assert f"best {MAX_LINES} of {len(many)}" in text
    assert "point 10<" in text and "point 2<" not in text
