"""Figures of sweeps: from the rows of a small sweep to the page."""

from pathlib import Path

import pytest
import yaml

from benchmarks import figure as figure_files
from benchmarks import page, sweep_figures
from benchmarks.sweep_figures import Swept, overview, sweep_figure
from neoworld_mjx.sweeps import Ablation, Plan
from neoworld_mjx.sweeps.folder import SweepFolder
from neoworld_mjx.sweeps.plan import points, read_plan
from neoworld_mjx.sweeps.result import stored_result
from neoworld_mjx.sweeps.run_rows import plain_value

XY, SMOOTH, DRIFT = "refine.cem.sigma_xy", "refine.cem.smoothing", "refine.max_drift_m"
ROOT = figure_files.ROOT
SCENES = [f"bench:{name}{start}" for name in "abcdefgh" for start in ("", "#1")]


def written(tmp_path, plan, row, kind=Plan, *, finished=True):
    """Write a folder as a sweep does, whose rows are `row(scene, values, seed)`."""
    verb = "ablations" if kind is Ablation else "sweeps"
    (tmp_path / verb).mkdir(exist_ok=True)
    file = tmp_path / verb / "plan.yaml"
    file.write_text(yaml.safe_dump({"scenes": SCENES, "seeds": 2} | plan))
    read_back = read_plan(file, kind)
    rows = [
        {"scene": scene, "point": point.label, "seed": seed, "fingerprint": "0"}
        | point.values
        | {"passed": True, "max_depth_m": 0.0, "max_drift_m": 0.0, "max_tilt_deg": 0.0}
        | row(scene, point.values, seed)
        for scene in read_back.scenes
        for point in points(read_back)
        for seed in read_back.seeds
    ]
    about = {
        "format": "neoworld-sweep/1",
        "kind": "ablation" if kind is Ablation else "sweep",
        "plan": read_back.model_dump(mode="json"),
        "points": [{"label": p.label, **p.values} for p in points(read_back)],
        "scenes": list(read_back.scenes),
        "groups": [],
        "commit": "abcdef0123+",
        "versions": {"jax": "0.1"},
        "machine": {"cores": 32, "processes": 31, "devices": ["cpu: cpu"]},
    }
    with SweepFolder(tmp_path / "rows", about["kind"], resume=False, overwrite=False) as folder:
        stored_result(rows, about, folder, finished=finished)
    swept = Swept(title="A sweep", plan=str(file), text="Its text.")
    return tmp_path / "rows", swept


AXES = {XY: [0.025, 0.05], SMOOTH: [0.0, 0.5]}


def error(scene, values, seed):
    """Return an error that smoothing doubles, and that depends on scene and seed besides."""
    base = 0.01 * (1 + SCENES.index(scene) % 3 + seed)
    return {"xy_error_m": base * (2 if values[SMOOTH] else 1), "merit": 1.0 - base}


@pytest.mark.usefixtures("without_drawing")
def test_each_value_is_compared_with_the_base_over_all_others(tmp_path):
    figure = sweep_figure(*written(tmp_path, {"axes": AXES}, error))
    rows = {(row[0], row[1]): dict(zip(figure.columns, row, strict=True)) for row in figure.rows}
    values = ["0.025", "0.05 (base)", "0 (base)", "0.5"]
    assert list(rows) == [(f"`cem.{name}`", values.pop(0)) for name in
                          ("sigma_xy", "sigma_xy", "smoothing", "smoothing")]  # fmt: skip
    same, other = rows["`cem.sigma_xy`", "0.025"], rows["`cem.smoothing`", "0.5"]
    assert {row["n"] for row in rows.values()} == {"64"}  # 8 scenes, 2 starts, 2 seeds, 2 others
    assert same["minus base: xy error, mm"] == "+0.0 [+0.0, +0.0]"
    assert same["scenes above:below the base"] == "0:0" and same["p"] == "1.000"
    # The mean error of the base, by hand: 10 mm (1 + k % 3 + seed) over the starts and seeds.
    mean = 10 * sum(1.5 + k % 3 for k in range(16)) / 16
    assert rows["`cem.smoothing`", "0 (base)"]["xy error, mm"].startswith(f"{mean:.1f} [")
    assert other["minus base: xy error, mm"].startswith(f"**+{mean:.1f} [+")
    # Two starts of a scene are one scene: 8 of 8, two-sided 2 / 256, of two comparisons.
    assert (other["scenes above:below the base"], other["p"]) == ("8:0", f"{4 / 256:.3f}")
    assert "2 values are compared" in figure.notes and "p values below .05: 1." in figure.notes
    assert figure.command.endswith("plan.yaml --out DIR --workers 31")
    assert (figure.commit, figure.n) == (
        "abcdef0",
        "4 points x 2 seeds x 16 initial scenes: 128 runs",
    )
    line = overview([figure]).splitlines()[3]
    assert line.startswith("| `cem.smoothing` |") and line.endswith("| 0.5 (xy error) |")
    assert f"{mean:.1f} to {2 * mean:.1f}" in line and "| none |" in overview([figure])


@pytest.fixture
def without_drawing(monkeypatch):
    monkeypatch.setattr(SweepFolder, "write_figure", lambda *_, **__: None)


@pytest.mark.usefixtures("without_drawing")
def test_options_that_advance_together_are_one(tmp_path):
    plan = {"axes": AXES, "zip": [[XY, SMOOTH]], "base": {"refine": {"cem": {"sigma_xy": 0.025}}}}
    figure = sweep_figure(*written(tmp_path, plan, error))
    assert [row[:2] for row in figure.rows] == [
        ["`cem.sigma_xy`, `cem.smoothing`", "0.025, 0 (base)"],
        ["`cem.sigma_xy`, `cem.smoothing`", "0.05, 0.5"],
    ]


@pytest.mark.usefixtures("without_drawing")
def test_the_final_check_has_the_bounds_of_the_base(tmp_path):
    def row(scene, values, seed):
        drift = 0.015 if seed else 0.007
        return error(scene, {SMOOTH: 0}, seed) | {
            "passed": drift < values[DRIFT],
            "max_drift_m": drift,
        }

    figure = sweep_figure(*written(tmp_path, {"axes": {DRIFT: [0.005, 0.01, 0.02]}}, row))
    passed = figure.columns.index("passed, %")
    assert {row[passed].split()[0] for row in figure.rows} == {"50.0"}


@pytest.mark.usefixtures("without_drawing")
def test_levels_of_noise_are_values(tmp_path):
    levels = ("layout", "all")
    scenes = [f"bench:{name}@{level}#1" for name in "abcd" for level in levels]

    def row(scene, values, seed):
        return {"xy_error_m": 0.01 if "@layout" in scene else 0.02, "merit": 0.5}

    figure = sweep_figure(*written(tmp_path, {"scenes": scenes, "axes": {XY: [0.05, 0.1]}}, row))
    noise = {row[1]: row for row in figure.rows if row[0] == "noise"}
    assert set(noise) == {"layout", "all (base)"} and noise["layout"][2] == "16"
    assert noise["layout"][figure.columns.index("minus base: xy error, mm")] == (
        "**-10.0 [-10.0, -10.0]**"
    )


@pytest.mark.usefixtures("without_drawing")
def test_variants_are_ordered_by_merit(tmp_path):
    def row(scene, values, seed):
        return {"merit": 1.0 if values["variant"] == "b" else 0.0, "xy_error_m": 0.01}

    variants = {name: {XY: value} for name, value in (("a", 0.1), ("b", 0.2))}
    folder, swept = written(tmp_path, {"variants": variants}, row, Ablation)
    figure = sweep_figure(folder, swept.model_copy(update={"compared": "merit"}))
    assert figure.rows[0][1] == "b" and len(figure.rows) == 3
    assert figure.command.startswith("neoworld ablate ")


@pytest.mark.usefixtures("without_drawing")
def test_rows_of_another_plan_or_of_a_part_are_refused(tmp_path):
    folder, swept = written(tmp_path, {"axes": AXES}, error, finished=False)
    with pytest.raises(ValueError, match="holds no finished sweep"):
        sweep_figure(folder, swept)
    (tmp_path / "b").mkdir()
    folder, swept = written(tmp_path / "b", {"axes": AXES}, error)
    other = tmp_path / "other.yaml"
    other.write_text(yaml.safe_dump({"scenes": SCENES, "axes": {XY: [0.05, 0.1]}}))
    with pytest.raises(ValueError, match="a sweep of another plan"):
        sweep_figure(folder, swept.model_copy(update={"plan": str(other)}))
    (tmp_path / "c").mkdir()
    with pytest.raises(ValueError, match=r"sigma_xy` lacks 0.05, the base's value"):
        sweep_figure(*written(tmp_path / "c", {"axes": {XY: [0.1, 0.2]}}, lambda *_: {
            "xy_error_m": 0.01, "merit": 0.0}))  # fmt: skip


@pytest.mark.usefixtures("without_drawing")
def test_a_folder_becomes_a_figure_and_its_page(tmp_path, monkeypatch):
    """From rows to YAML to page, and without rows the page says so."""
    folder, swept = written(tmp_path, {"axes": AXES}, error)
    contents = page.read_contents()
    open_page = next(each for each in contents.pages if each.name == "open")
    only = open_page.model_copy(update={"figures": ["sweep_small"]})
    contents = contents.model_copy(
        update={"pages": [only], "swept": {"sweep_small": swept}, "key": [], "tables": {}}
    )
    monkeypatch.setattr(page, "read_contents", lambda: contents)
    monkeypatch.setattr(page, "results_page", lambda *_: "")
    for module in (page, figure_files):
        monkeypatch.setattr(module, "FIGURES", tmp_path)
    path = Path("docs/benchmarks/open.md")
    before = page.pages()
    assert "**Not measured yet.**" in before[path] and swept.command in before[path]
    assert "A sweep" in before[Path("docs/benchmarks.md")] and "| option |" not in before[path]
    page.write_figure("sweep_small", folder, ())
    stored = yaml.safe_load((tmp_path / "sweep_small.yaml").read_text())
    after = page.pages()[path]
    assert "Not measured yet" not in after and "older version" not in after
    for row in stored["rows"]:
        assert f"| {' | '.join(row)} |" in after
    assert overview([page.read_figure("sweep_small")]) in after
    with pytest.raises(ValueError, match=r"no plan for sweep_smal: page\.yaml has sweep_small"):
        page.write_figure("sweep_smal", folder, ())


@pytest.mark.parametrize("name", sorted(page.read_contents().swept))
def test_plans_of_figures_have_the_base_among_their_values(name):
    """Plans that `sweep_figure` would refuse after hours are refused at once."""
    swept = page.read_contents().swept[name]
    file, ablation = ROOT / swept.plan, "ablations" in swept.plan
    plan = read_plan(file, Ablation) if ablation else read_plan(file, Plan)
    assert swept.command.split()[:3] == ["neoworld", "ablate" if ablation else "sweep",
                                         swept.plan]  # fmt: skip
    rows = [
        {path: plain_value(value) for path, value in point.values.items()} | {"scene": scene}
        for point in points(plan)
        for scene in plan.scenes
    ]
    for factor in sweep_figures._factors(plan, rows):
        assert factor.base in factor.values and len(set(factor.values)) > 1
    if not ablation:
        scenes = {each.partition("#")[0].partition("@")[0]: each[-2:] for each in plan.scenes}
        assert len(plan.seeds) == 3 and sum(end == "#1" for end in scenes.values()) * 2 == len(
            scenes
        )
