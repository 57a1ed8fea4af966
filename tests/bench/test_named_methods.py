"""Methods that a user names, and results folders that hold one set of options for each name."""

import json
import shutil

import pytest
from neoworld_bench.methods.method_runs import RunSettings
from neoworld_bench.methods.named_methods import METHODS_FILE, read_methods
from neoworld_bench.methods.scene_methods import check_methods, in_order, is_budgeted
from neoworld_bench.methods.scene_runs import RESULTS, known_rows, run_scenes
from neoworld_bench.row_files import column_types
from neoworld_bench.tables.scene_table import scene_tables

from neoworld_mjx.config import ComposeOptions, load_config
from neoworld_mjx.errors import ConfigError, RunError, SpecError
from neoworld_mjx.io.parquet_files import write_rows

SMALL = {
    "refine": {
        "cem": {"population": 8, "iterations": 1},
        "rollout": {"duration_s": 0.2, "samples_per_object": 32},
        "check_duration_s": 0.2,
        "finalists": 1,
    },
    "compose": {"align": {"enabled": False}},
}


def settings(named=(), **reward):
    config = load_config(None, {**SMALL, "refine": {**SMALL["refine"], "reward": reward}})
    return RunSettings(0, config.refine, ComposeOptions(align=config.compose.align), "all", named)


def run(tmp_path, methods, used):
    return run_scenes(("tents",), methods, used, starts=1, out=tmp_path)


WIDE = "refine: {cem: {sigma_xy: 0.1}, optimizer: random}\n"


def named_methods(folder, wide=WIDE):
    """Options of the search as `narrow`, those of a file as `wide`, and settling alone."""
    file = folder / "wide.yaml"
    file.write_text(wide)
    config = load_config(None, SMALL)
    return read_methods(["ours", "open_loop", f"wide={file}"], "narrow", config)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A folder with a row of each method; most of the time is that of the scene's photograph."""
    home = tmp_path_factory.mktemp("finished")
    methods, named = named_methods(home)
    return home / "out", run(home / "out", methods, settings(named))


@pytest.fixture
def stored(finished, tmp_path):
    """A copy of that folder, and its row of open_loop."""
    shutil.copytree(finished[0], tmp_path, dirs_exist_ok=True)
    (row,) = (row for row in finished[1] if row.method == "open_loop")
    return row


def test_a_folder_refuses_other_options_of_the_same_method(stored, tmp_path):
    row = stored
    noted = json.loads((tmp_path / METHODS_FILE).read_text())
    assert noted["open_loop"]["options"]["refine"]["cem.population"] == 8
    before = (tmp_path / RESULTS).read_bytes()
    with pytest.raises(RunError, match=r"other options \(refine.reward.w_pen was 1.0, is 0.5\)"):
        run(tmp_path, ("open_loop",), settings(w_pen=0.5))
    assert (tmp_path / RESULTS).read_bytes() == before
    assert run(tmp_path, ("open_loop",), settings()) == [row]
    (tmp_path / METHODS_FILE).unlink()
    with pytest.raises(RunError, match="has rows of open_loop with unknown options"):
        run(tmp_path, ("open_loop",), settings())


def test_a_table_refuses_rows_of_one_method_with_different_options(stored, tmp_path):
    row = stored
    other = row.model_copy(update={"start": 1, "fingerprint": "other"})
    rows = [each.model_dump() for each in (row, other)]
    write_rows(tmp_path / RESULTS, rows, column_types(type(row)), RunError)
    with pytest.raises(RunError, match="rows of open_loop on tents with different options"):
        scene_tables(tmp_path)


def test_methods_of_a_user_are_rows_beside_ours(finished, tmp_path):
    methods, named = named_methods(tmp_path)
    assert methods == ("narrow", "open_loop", "wide")
    assert dict(named)["wide"].cem.sigma_xy == 0.1 and dict(named)["wide"].cem.population == 8
    out, rows = finished
    assert [row.method for row in rows] == ["narrow", "open_loop", "wide"]
    assert rows[0].rollouts > 1 and len({row.fingerprint for row in rows}) == 3
    noted = json.loads((out / METHODS_FILE).read_text())
    assert noted["wide"]["options"]["refine"]["optimizer"] == "random"
    assert len(known_rows(out)) == 3
    assert "| wide | 1 |" in scene_tables(out)["table.md"]
    # The same name cannot stand for other options.
    methods, named = named_methods(tmp_path, WIDE.replace("0.1", "0.2"))
    shutil.copytree(out, tmp_path / "out")
    with pytest.raises(RunError, match=r"rows of wide .*sigma_xy was 0.1, is 0.2"):
        run(tmp_path / "out", methods, settings(named))


def test_errors_name_the_method_and_the_option(tmp_path):
    config = load_config(None, SMALL)
    file = tmp_path / "o.yaml"
    for text, names, label, message in (
        ("refine: {cem: {sigma: 1}}", [f"wide={file}"], None, "unknown key refine.cem.sigma"),
        ("seed: 3", [f"wide={file}"], None, "those under refine, and no others"),
        ("refine: {}", [f"ours={file}"], None, "the name ours is taken"),
        ("refine: {}", [f"a b={file}"], None, "a name has letters, digits"),
        ("refine: {}", ["open_loop"], "mine", "--label mine names the row of ours: add ours"),
        ("refine: {}", ["ours"], "gravity", "the name gravity is taken"),
    ):
        file.write_text(text)
        with pytest.raises(ConfigError, match=message):
            read_methods(names, label, config)
    with pytest.raises(SpecError, match="method: "):
        check_methods(["opn_loop"])
    with pytest.raises(ConfigError, match="cannot import"):
        check_methods(["nowhere:optimizer"])


def test_optimizers_by_name_are_methods_with_our_rollouts():
    pytest.importorskip("evosax", reason="needs the extra baselines")
    check_methods(["evosax:SNES", "ours"])
    assert is_budgeted("evosax:SNES") and is_budgeted("random") and not is_budgeted("ours")
    assert in_order(["evosax:SNES", "gravity", "ours"]) == ["ours", "gravity", "evosax:SNES"]
    with pytest.raises(ConfigError, match="did you mean 'SNES'"):
        check_methods(["evosax:SNE"])
