"""The thirty scenes: declarations, ground truths, errors of layouts, methods, summaries, tables."""

import math
from typing import Any, get_args

import pytest
from neoworld_bench.dataset.declaration import ARRANGEMENTS, Room, declaration, declarations
from neoworld_bench.dataset.settle_scene import failures
from neoworld_bench.dataset.truth_scene import truth_scene
from neoworld_bench.methods.layout_errors import displaced, layout_errors, tilt_deg
from neoworld_bench.methods.method_runs import RunSettings, run_jobs
from neoworld_bench.methods.scene_methods import (
    SEARCHES,
)
from neoworld_bench.methods.scene_runs import (
    SceneRow,
    chosen_scenes,
    scene_rows,
)
from neoworld_bench.noise.initial_scenes import noise_number
from neoworld_bench.rows import ROWS, RowStore
from neoworld_bench.tables.scene_figures import scene_summary

from neoworld_mjx.config import (
    RefineOptions,
    list_options,
    load_config,
    option_values,
)
from neoworld_mjx.errors import SpecError
from neoworld_mjx.spec import bounds
from neoworld_mjx.spec.pose import from_axis_angle, from_yaw, pose, quat_mul
from tests.support.scenes import changed

CHEAP = ("tents", "dominoes", "desk_drawers", "overhang_stack")


def test_thirty_scenes_of_every_room():
    every = declarations()
    assert len(every) == 30 and {d.room for d in every.values()} == set(get_args(Room))
    assert sum(d.tabletop for d in every.values()) == 11
    assert len(chosen_scenes(["3"])) == 3 and len(chosen_scenes([])) == 30
    twelve = chosen_scenes(["arrangements"])
    assert twelve == tuple(declarations(ARRANGEMENTS)) and len(twelve) == 12
    assert not set(twelve) & set(every) and chosen_scenes([twelve[0]]) == twelve[:1]
    numbers = {noise_number(n, s, k) for n in every for s in range(3) for k in range(9)}
    assert len(numbers) == 30 * 27, "initial scenes have independent noise"


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name, marks=() if name not in declarations() or name in CHEAP else pytest.mark.slow
        )
        for name in (*declarations(), *declarations(ARRANGEMENTS))
    ],
)
def test_ground_truth_passes_the_final_check(name: str):
    assert failures(truth_scene(declaration(name))) == []


def test_each_error_affects_its_own_figure():
    scene = truth_scene(declarations()["dominoes"])
    names = ("xy_error_m", "yaw_error_deg", "scale_error", "edge_error")
    assert layout_errors(scene, scene) == dict.fromkeys(names, 0.0)
    objects = [i for i in scene.objects if not i.static]
    first = objects[0]
    pushed = layout_errors(changed(scene, first.name, xy=(first.xy[0] + 0.03, first.xy[1])), scene)
    assert pushed["xy_error_m"] == pytest.approx(0.03 / len(objects))
    assert pushed["yaw_error_deg"] == 0.0
    turned = layout_errors(changed(scene, first.name, yaw=first.yaw + 0.2), scene)
    assert turned["yaw_error_deg"] > 0.5 and turned["xy_error_m"] < 1e-6
    # An offset that all objects share is an error of the camera, not of the layout.
    table = scene.objects[0]
    alike = layout_errors(changed(scene, table.name, xy=(table.xy[0] + 0.05, 0.0)), scene)
    assert alike["xy_error_m"] < 1e-9
    fixed = scene.model_copy(update={"objects": tuple(i for i in scene.objects if i.static)})
    with pytest.raises(SpecError, match="no movable object of the ground truth"):
        layout_errors(fixed, scene)


def test_toppled_and_fallen_objects_are_displaced():
    scene = truth_scene(declarations()["overhang_stack"])
    tin, cup = scene.object("tin"), scene.object("cup")
    assert displaced(scene, scene) == []
    assert displaced(changed(scene, "tin", z=tin.z - 0.1), scene) == ["tin"]
    lying = (0.7071068, 0.7071068, 0.0, 0.0)
    assert displaced(changed(scene, "cup", base_tilt=lying), scene) == ["cup"]
    # Elsewhere, turned or larger, it stands as it should.
    aside = changed(scene, "cup", xy=(cup.xy[0] + 0.1, cup.xy[1]), yaw=1.0)
    assert displaced(aside, scene) == []
    assert displaced(changed(scene, "cup", spec=cup.spec.scaled(1.6)), scene) == []
    # An object on a taller support is expected to be higher.
    below = scene.object(tin.parent)
    tall = changed(scene, below.name, spec=below.spec.scaled(3.0))
    high = float(bounds(tall.object(below.name).spec)[1][2] - bounds(below.spec)[1][2])
    assert "tin" not in displaced(changed(tall, "tin", z=tin.z + high), scene)
    assert "tin" in displaced(tall, scene)
    pencils = truth_scene(declarations()["pencils_in_cup"])
    pencil = pencils.object("pencil_0")
    at = lambda quat: pose((0, 0, 0), quat)
    leans = quat_mul(from_yaw(2.0), pencil.base_tilt)
    assert tilt_deg(pencil, at(leans), at(pencil.base_tilt)) < 0.01
    further = quat_mul(from_axis_angle([0, 1, 0], math.radians(80.0)), pencil.base_tilt)
    assert tilt_deg(pencil, at(further), at(pencil.base_tilt)) > 15.0


def test_algorithm_1_has_the_papers_value_of_every_option_of_the_search():
    values = option_values(SEARCHES["algorithm1"](RefineOptions()))
    for option in list_options(RefineOptions):
        if option.difference is not None and not option.path.startswith("semantic."):
            assert values[option.path] == option.difference.value, option.path


def test_random_search_differs_from_ours_by_its_optimizer_alone():
    other = SEARCHES["random"](RefineOptions())
    assert other == RefineOptions(optimizer="random") != RefineOptions()


SMALL = {
    "refine": {
        "cem": {"population": 8, "iterations": 1},
        "rollout": {"duration_s": 0.2, "samples_per_object": 32},
        "check_duration_s": 0.2,
        "finalists": 1,
    },
    "compose": {"align": {"enabled": False}},
}


def test_stored_rows_are_not_run_again(tmp_path):
    config = load_config(None, SMALL)
    settings = RunSettings(0, config.refine, config.compose, "layout")

    def run():
        methods, store = ("open_loop", "guided"), RowStore(tmp_path / ROWS)
        of = {"methods": methods, "settings": settings, "store": store}
        return run_jobs(scene_rows, SceneRow, starts={"tents": range(1)}, **of)

    rows = run()
    assert [row.method for row in rows] == ["open_loop", "guided"]
    assert all(row.accepted is None for row in rows), "neither searches"
    before = (tmp_path / ROWS).read_bytes()
    assert run() == rows and (tmp_path / ROWS).read_bytes() == before


def row_of(method: str, *, valid: bool, scene: str = "tents", start: int = 0, **more: Any):
    fields = dict.fromkeys(SceneRow.model_fields, 0) | {
        "scene": scene, "room": "tabletop", "tabletop": scene == "tents", "objects": 4,
        "start": start, "evaluation": start % 2 == 1, "method": method, "valid": valid,
        "check_passed": valid, "accepted": valid if method == "ours" else None,
        "noise": "layout", "injected": "", "refused": "", "evidence": "none", "s_stab": valid,
        "deviations": {}, "o_stab": 1.0, "xy_error_m": 0.01,
        "seconds_to_valid": 2.0 if valid else None,
    }  # fmt: skip
    return SceneRow.model_validate(fields | more)


def test_summary_compares_methods_and_counts_objects():
    rows = [row_of("ours", valid=True, start=k) for k in range(2)]
    rows += [row_of("open_loop", valid=k == 0, start=k, xy_error_m=0.02) for k in range(2)]
    rows += [row_of("gravity", valid=False, o_stab=0.5)]
    rows += [row_of("gravity", valid=False, scene="dominoes", objects=12)]
    summary = scene_summary(rows)
    assert (summary["n"], summary["scenes"], summary["starts"]) == (6, 2, 2)
    compared = summary["differences"]
    assert compared["to"] == "ours"
    farther = compared["methods"]["open_loop"]["xy_error_m"]
    assert (farther["n"], farther["mean"]) == (2, pytest.approx(0.01))
    assert compared["methods"]["gravity"]["edge_error"]["n"] == 1, "pairs have the same start"
    rates = {name: of["accepted_rate"] for name, of in summary["methods"].items()}
    assert rates == {"ours": 1.0, "open_loop": None, "gravity": None}
    assert summary["methods"]["ours"]["seconds_to_valid"] == 2.0
    assert summary["methods"]["gravity"]["o_stab"] == pytest.approx(14 / 16), "over objects"
    assert summary["evaluation"]["open_loop"]["valid_rate"] == 0.0
    own = scene_summary([row_of("ours", valid=False, missed=1, extra=2, displaced=1)])
    figures = own["methods"]["ours"]
    assert (figures["objects"], figures["found"]) == (4, 3)
    shares = [figures[name] for name in ("displaced", "missed", "extra")]
    assert shares == pytest.approx([1 / 3, 1 / 4, 2 / 4])
    near = [row_of("ours", valid=True, start=k, within_10mm=0.5 + k / 2) for k in range(2)]
    near.append(row_of("ours", valid=True, start=2, camera_error_m=0.03))
    figures = scene_summary(near)["methods"]["ours"]
    assert figures["camera_error_m"] == pytest.approx(0.01)
    assert figures["camera_error_median_m"] == 0.0 and figures["within_10mm"] == 0.5
