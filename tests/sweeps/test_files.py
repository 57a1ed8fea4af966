"""What a sweep leaves behind: iterations, tables in three forms, and a figure."""

import csv
import io
import re
import sys
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from neoworld_mjx.sweeps import table as sweep_table
from neoworld_mjx.sweeps.figure import MAX_LINES, draw
from neoworld_mjx.sweeps.folder import SweepFolder
from neoworld_mjx.sweeps.rank_figure import cliques, draw_ranks, ranks
from neoworld_mjx.sweeps.run_rows import iteration_rows, read_runs, summaries, write_runs
from neoworld_mjx.sweeps.table import comma_separated, differences, summary, text_table

SIGMA, DRIFT = "refine.cem.sigma_xy", "refine.reward.w_drift"


def run(point, seed, sigma, drift, reward=0.5, **more):
    steps = [
        {"iteration": t + 1, "rollouts": 8 * (t + 1), "best": reward - 0.1 / (t + 1),
         "merit": reward, "mean": 0.0, "valid": 0.5,
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


def test_iterations_summarize_the_candidates_with_a_reward():
    history = {
        "absolute": np.array([[0.2, -np.inf, 0.4], [0.3, 0.1, -np.inf]]),
        "merit": np.array([[0.5, -np.inf, 0.9], [0.4, 0.7, -np.inf]]),
        "valid": np.array([[True, False, False], [True, True, False]]),
        "status": np.array([[0, 5, 0], [0, 0, -1]]),
        "s_sem": np.array([[0.5, np.nan, 0.9], [0.6, 0.7, np.nan]]),
    }
    first, second = iteration_rows(summaries(history | {"term_names": np.array(["s_sem"])}))
    assert (first["iteration"], second["iteration"]) == (1, 2)
    assert first["best"] == second["best"] == 0.4
    assert first["mean"] == pytest.approx(0.3) and second["mean"] == pytest.approx(0.2)
    assert first["valid"] == pytest.approx(1 / 3) and second["valid"] == 1.0
    assert (first["s_sem"], second["s_sem"]) == (0.9, 0.6)
    # Rollouts and the merit of the best valid candidate are those so far.
    assert (first["rollouts"], second["rollouts"]) == (3, 5)
    assert (first["merit"], second["merit"]) == (0.5, 0.7)


def test_an_iteration_without_a_scored_candidate_has_no_reward():
    history = {"absolute": np.full((1, 2), -np.inf), "valid": np.zeros((1, 2), bool)}
    history |= {"merit": np.full((1, 2), -np.inf)}
    history |= {"status": np.array([[2, 2]]), "s_sem": np.full((1, 2), np.nan)}
    (only,) = iteration_rows(summaries(history | {"term_names": np.array(["s_sem"])}))
    assert all(only[name] is None for name in ("best", "merit", "mean", "s_sem"))


def test_a_folder_keeps_the_iterations(tmp_path):
    with SweepFolder(tmp_path / "out", "sweep", resume=False, overwrite=False) as folder:
        folder.write(ROWS, [SIGMA, DRIFT], {"table.md": "t"})
    with SweepFolder(tmp_path / "out", "sweep", resume=True, overwrite=False) as again:
        assert [row["history"] for row in again.rows] == [row["history"] for row in ROWS]
    with SweepFolder(tmp_path / "out", "sweep", resume=False, overwrite=True):
        names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == [".lock", "sweep.json"]


def test_custom_terms_are_saved(tmp_path):
    rows = [
        row | {"history": [step | {"upright": 0.25} for step in row["history"]]} for row in ROWS
    ]
    with SweepFolder(tmp_path, "sweep", resume=False, overwrite=False) as folder:
        folder.write(rows, [SIGMA, DRIFT], {})
    with SweepFolder(tmp_path, "sweep", resume=True, overwrite=False) as again:
        assert [row["history"] for row in again.rows] == [row["history"] for row in rows]


def test_runs_without_iterations_are_saved(tmp_path):
    with SweepFolder(tmp_path, "sweep", resume=False, overwrite=False):
        write_runs(tmp_path / "results.parquet", ROWS, [SIGMA, DRIFT])
    with SweepFolder(tmp_path, "sweep", resume=True, overwrite=False) as again:
        pass
    assert len(again.rows) == len(ROWS) and not again.rows[0]["history"]
    assert read_runs(tmp_path / "results.parquet")[0][SIGMA] == 0.03


def test_csv_and_latex_agree():
    summed = summary(ROWS, [ROWS[0]["point"], ROWS[2]["point"]])
    first, second = csv.DictReader(io.StringIO(comma_separated(summed)))
    assert first["point"] == "s 0.03, d 0.5" and second["n"] == "2"
    assert float(first["passed"]) == 0.5 and float(second["d_drift"]) == pytest.approx(0.1)
    text = text_table("Sweep", summed).latex()
    assert text.count(r"\\") == 3 and r"D\_drift" in text and "0.050 [" in text
    assert text.count("&") == 3 * text.splitlines()[3].count("&")


def test_latex_commands_in_cells_are_escaped():
    summed = summary([run(r"\input{x} 50 % & _", 0, 1, 1)], [r"\input{x} 50 % & _"])
    line = text_table("Ablation", summed).latex().splitlines()[5]
    assert line.startswith(r"\textbackslash{}input\{x\} 50 \% \& \_ & 1 & 1 & 100.0")


def test_a_parser_of_latex_reads_every_cell():
    """No TeX is needed: pylatexenc parses strictly, and the text of each cell is its own."""
    walker = pytest.importorskip("pylatexenc.latexwalker")
    from pylatexenc.latex2text import LatexNodes2Text

    names = ["base", r"\input{x} 50 % & _", "[0.1, 0.2] ~ ^ # $x$", "a {b} c"]
    rows = [run(name, 0, seed, 1, reward=0.1 * seed) for name in names for seed in range(3)]
    tables = [
        text_table("A", summary(rows, names)),
        sweep_table.tests_table("B", differences(rows, names)),
    ]
    text = "\n".join(table.latex() for table in tables)
    nodes, *_ = walker.LatexWalker(text, tolerant_parsing=False).get_latex_nodes()
    found = [node for node in nodes if node.isNodeType(walker.LatexEnvironmentNode)]
    assert [node.environmentname for node in found] == ["tabular", "tabular"]
    for node, table in zip(found, tables, strict=True):
        lines = node.latex_verbatim().partition("\\toprule\n")[2].partition("\\bottomrule")[0]
        lines = [each for each in lines.split("\\\\\n") if each.strip()]
        for line, row in zip(lines, [table.head, *table.rows], strict=True):
            line = line.removeprefix("\\midrule\n")
            # After a line's end, [ or * would be an argument of it.
            assert not line.startswith(("[", "*"))
            cells = re.split(r"(?<!\\)&", line)
            read = [
                LatexNodes2Text().latex_to_text(cell).strip().replace("ˆ", "^") for cell in cells
            ]
            assert read == [cell.strip() for cell in row]


def test_differences_are_signed():
    rows = [run("base", 0, 1, 1), run("more", 0, 1, 1, reward=0.9)]
    assert "+0.400" in text_table("x", differences(rows, ["base", "more"]), signed=True).latex()


def test_a_figure_shows_points_axes_and_terms():
    drawn = draw(ROWS, [SIGMA, DRIFT])
    assert drawn == draw(ROWS, [SIGMA, DRIFT])
    assert draw(ROWS, [SIGMA, DRIFT], "pdf").startswith(b"%PDF") and drawn is not None
    drawn = drawn.decode()
    text = "\n".join(part.text or "" for part in ET.fromstring(drawn).iter())
    for label in ("s 0.06, d 1.0", "passed, %", "sigma_xy", "w_drift", "S_sem", "not passed"):
        assert label in text, label


def test_a_figure_of_one_axis_none_and_many_points():
    one = "".join(ET.fromstring(draw(ROWS[:4], [SIGMA, DRIFT])).itertext())
    assert "w_drift" in one and "sigma_xy" not in one
    assert b"passed, %" not in draw(ROWS[:1], [SIGMA, DRIFT])
    many = [run(f"point {k}", 0, 0.1, float(k), reward=k / 20) for k in range(MAX_LINES + 3)]
    text = draw(many, [DRIFT]).decode()
    assert f"best {MAX_LINES} of {len(many)}" in text
    assert "point 10<" in text and "point 2<" not in text


def ablated(errors):
    return [
        {"scene": f"s{k}", "point": point, "seed": 0, "xy_error_m": value, "d_drift": 0.0}
        for point, values in errors.items()
        for k, value in enumerate(values)
    ]


def test_ranks_are_those_of_demsar():
    """Table 6 of Demšar (2006): four methods on 14 data sets have CD 2.569 sqrt(4 5 / (6 14))."""
    rng = np.random.default_rng(0)
    rows = ablated({name: rng.random(14) + k for k, name in enumerate("abcd")})
    found = ranks(rows, list("abcd"))
    assert found.points == list("abcd") and found.scenes == 14
    assert found.critical == pytest.approx(2.569 * np.sqrt(4 * 5 / (6 * 14)), rel=1e-3)
    assert found.means == [1.0, 2.0, 3.0, 4.0] and found.friedman_p < 1e-6
    # Neighbors are within the critical difference of 1.25, others are not.
    assert cliques(found) == [(0, 1), (1, 2), (2, 3)]
    text = "".join(ET.fromstring(draw_ranks(found, "svg")).itertext())
    assert "critical difference 1.25" in text and "mean rank by xy error over 14 scenes" in text


def test_ranks_share_ties_and_need_three_points_and_two_scenes():
    found = ranks(ablated({"a": [1, 1], "b": [1, 1], "c": [0, 2]}), ["a", "b", "c"])
    assert dict(zip(found.points, found.means, strict=True)) == {"a": 2.0, "b": 2.0, "c": 2.0}
    assert ranks(ablated({"a": [1, 1], "b": [1, 1]}), ["a", "b"]) is None
    assert ranks(ablated({"a": [1], "b": [1], "c": [1]}), ["a", "b", "c"]) is None
    # Where an error is unknown, all are ranked by drift.
    unknown = ablated({"a": [1, 1], "b": [1, 1], "c": [None, None]})
    assert ranks(unknown, ["a", "b", "c"]).title == "D_drift"


def test_without_matplotlib_the_log_says_why_there_is_no_figure(monkeypatch, caplog):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with caplog.at_level("INFO", logger="neoworld_mjx"):
        assert draw(ROWS, [SIGMA]) is None
    assert "--extra plot" in caplog.text
