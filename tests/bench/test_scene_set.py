"""The thirty scenes: declarations, ground truths, layout errors, summaries and tables."""

import math
from dataclasses import replace
from typing import get_args

import jax
import numpy as np
import pytest
from neoworld_bench.dataset.declaration import Room, declarations, read_declaration
from neoworld_bench.dataset.make_dataset import make_dataset, rounded
from neoworld_bench.dataset.settle_scene import failures
from neoworld_bench.dataset.truth_scene import truth_scene
from neoworld_bench.engines.table_scenes import crowded
from neoworld_bench.fidelity.rendered_responses import exact_response
from neoworld_bench.fidelity.rendered_scenes import see
from neoworld_bench.methods.layout_errors import displaced, layout_errors, tilt_deg
from neoworld_bench.methods.method_runs import RunSettings
from neoworld_bench.methods.scene_methods import METHODS, SingleCandidateEngine
from neoworld_bench.methods.scene_runs import RESULTS, SceneRow, chosen_scenes, run_scenes
from neoworld_bench.noise.initial_scenes import noise_number
from neoworld_bench.suites import SceneSet
from neoworld_bench.tables.scene_summary import BOUNDS, interval, summarise
from neoworld_bench.tables.scene_table import latex, markdown, table_records

from neoworld_mjx.compose.compose import compose
from neoworld_mjx.config import ComposeOptions, RefineOptions
from neoworld_mjx.errors import RunError, SpecError
from neoworld_mjx.io.parquet_files import write_rows
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.physics.settling import with_world_poses
from neoworld_mjx.physics.support import underside_points
from neoworld_mjx.spec import bounds, world_poses
from neoworld_mjx.spec.pose import from_axis_angle, from_yaw, pose, quat_mul
from tests.support.scenes import changed, compile_scene

CHEAP = ("tents", "dominoes", "desk_drawers", "overhang_stack")


def test_thirty_scenes_of_every_room():
    every = declarations()
    assert len(every) == 30 and {d.room for d in every.values()} == set(get_args(Room))
    assert sum(d.tabletop for d in every.values()) == 11
    counts = sorted(len(d.movable()) for d in every.values())
    assert counts[0] >= 3 and counts[-3] <= 10 and counts[-2:] == [20, 40]


@pytest.mark.parametrize("name", CHEAP)
def test_ground_truth_passes_the_final_check(name: str):
    assert failures(truth_scene(declarations()[name])) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(declarations()) - set(CHEAP)))
def test_every_ground_truth_passes_the_final_check(name: str):
    assert failures(truth_scene(declarations()[name])) == []


def test_tent_without_one_board_falls():
    scene = truth_scene(declarations()["tents"])
    without = [item for item in scene.objects if item.name != "leaf_0b"]
    alone = scene.model_copy(update={"objects": tuple(without)})
    assert {check.where for check in failures(alone)} == {"leaf_0a"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("room: tabletop", "room: moon"), "room: Input should be 'tabletop'"),
        (("parent: table", "parent: tabel"), "'tabel' must come before it"),
        (("caption:", "captoin:"), "unknown key captoin: got .captoin."),
        (("camera: {", "camera: ["), "is no YAML of a scene"),
    ],
)
def test_errors_of_declarations_name_the_field(tmp_path, change: tuple[str, str], message: str):
    from neoworld_bench.dataset.declaration import SCENES

    path = tmp_path / "tents.yaml"
    path.write_text((SCENES / "tents.yaml").read_text().replace(*change, 1))
    with pytest.raises(SpecError, match=message):
        read_declaration(path)


def test_errors_name_unknown_scenes_and_programs(tmp_path):
    with pytest.raises(SpecError, match="got 'tent', valid are"):
        chosen_scenes(["tent"])
    with pytest.raises(SpecError, match="1 to 30"):
        chosen_scenes(["31"])
    assert len(chosen_scenes(["3"])) == 3 and len(chosen_scenes([])) == 30
    tents = declarations()["tents"]
    wrong = tents.objects[0].model_copy(update={"program": "blok"})
    broken = tents.model_copy(update={"objects": (wrong,)})
    with pytest.raises(SpecError, match="object leaf_0a: object leaf_0a, program: got 'blok'"):
        truth_scene(broken)


def test_exact_response_composes_to_the_ground_truth():
    # An open drawer with something inside: joints and carriers must be answered, too.
    scene = see(truth_scene(declarations()["desk_drawers"]))
    tree = exact_response(scene)
    shapes = {item.name: item.spec for item in scene.objects}
    composed = compose(tree, shapes).scene
    errors = layout_errors(composed, scene)
    assert max(errors["xy_error_m"], errors["scale_error"]) < 1e-3
    assert errors["yaw_error_deg"] < 0.1
    assert composed.object("chest").joint_state["drawer_2_slide"] == pytest.approx(
        scene.object("chest").joint_state["drawer_2_slide"], abs=1e-6
    )


def test_each_error_affects_its_own_figure():
    scene = truth_scene(declarations()["dominoes"])
    zero = layout_errors(scene, scene)
    names = ("xy_error_m", "yaw_error_deg", "scale_error", "edge_error")
    assert zero == dict.fromkeys(names, 0.0)
    objects = [i for i in scene.objects if not i.static]
    first = objects[0]
    shifted = changed(scene, first.name, xy=(first.xy[0] + 0.03, first.xy[1]))
    pushed = layout_errors(shifted, scene)
    assert pushed["xy_error_m"] == pytest.approx(0.03 / len(objects))
    assert pushed["yaw_error_deg"] == 0.0
    turned = layout_errors(changed(scene, first.name, yaw=first.yaw + 0.2), scene)
    assert turned["yaw_error_deg"] > 0.5 and turned["xy_error_m"] < 1e-6
    # What a wrong camera does to all of them alike is no error of the layout.
    table = scene.objects[0]
    alike = layout_errors(changed(scene, table.name, xy=(table.xy[0] + 0.05, 0.0)), scene)
    assert alike["xy_error_m"] < 1e-9


def test_scenes_without_a_common_movable_object_have_no_errors_of_the_layout():
    truth = truth_scene(declarations()["dominoes"])
    fixed = truth.model_copy(update={"objects": tuple(i for i in truth.objects if i.static)})
    for scene, other in ((fixed, truth), (truth, fixed)):
        with pytest.raises(SpecError, match="no movable object of the ground truth"):
            layout_errors(scene, other)


def test_toppled_and_fallen_objects_are_displaced():
    scene = truth_scene(declarations()["overhang_stack"])
    assert displaced(scene, scene) == []
    tin, cup = scene.object("tin"), scene.object("cup")
    assert displaced(changed(scene, "tin", z=tin.z - 0.1), scene) == ["tin"]
    lying = (0.7071068, 0.7071068, 0.0, 0.0)
    assert displaced(changed(scene, "cup", base_tilt=lying), scene) == ["cup"]
    # Shifted aside it is in the wrong place, but stands as it should.
    aside = changed(scene, "cup", xy=(cup.xy[0] + 0.1, cup.xy[1]), yaw=1.0)
    assert displaced(aside, scene) == []


def test_size_and_heading_do_not_count_as_displacement():
    scene = truth_scene(declarations()["overhang_stack"])
    tin = scene.object("tin")
    below = scene.object(tin.parent)
    assert displaced(_scaled(scene, "cup", 1.6), scene) == []
    # What stands on something too high is too high as well, and stands; what floats there does not.
    tall = _scaled(scene, below.name, 3.0)
    high = float(bounds(tall.object(below.name).spec)[1][2] - bounds(below.spec)[1][2])
    assert high > 0.03
    assert "tin" not in displaced(changed(tall, "tin", z=tin.z + high), scene)
    assert "tin" in displaced(tall, scene)
    assert displaced(changed(scene, "tin", z=tin.z + high), scene) == ["tin"]
    pencils = truth_scene(declarations()["pencils_in_cup"])
    pencil = next(i for i in pencils.objects if i.name == "pencil_0")
    leans = tuple(quat_mul(from_yaw(2.0), pencil.base_tilt).tolist())
    assert tilt_deg(pencil, pose((0, 0, 0), leans), pose((0, 0, 0), pencil.base_tilt)) < 0.01
    assert displaced(changed(pencils, "pencil_0", base_tilt=leans), pencils) == []
    further = quat_mul(from_axis_angle([0, 1, 0], math.radians(80.0)), pencil.base_tilt)
    assert tilt_deg(pencil, pose((0, 0, 0), further), pose((0, 0, 0), pencil.base_tilt)) > 15.0


def _scaled(scene, name, by):
    return changed(scene, name, spec=scene.object(name).spec.scaled(by))


def test_moved_objects_have_their_new_poses():
    scene = truth_scene(declarations()["pipes_and_plank"])
    poses = world_poses(scene)
    ends = {"plank": poses["brick"], "tin": poses["plank"]}
    placed = world_poses(with_world_poses(scene, ends))
    for name, end in ends.items():
        np.testing.assert_allclose(placed[name].pos, end.pos, atol=1e-9)
        assert abs(placed[name].quat @ end.quat) == pytest.approx(1.0)
    np.testing.assert_allclose(placed["pipe_1"].pos, poses["pipe_1"].pos)


def test_initial_scenes_have_independent_noise():
    numbers = {noise_number(n, s, k) for n in declarations() for s in range(3) for k in range(9)}
    assert len(numbers) == 30 * 27


def test_hashes_ignore_only_the_last_digits():
    assert rounded({"a": [0.1 + 0.2, 1e-17]}) == {"a": [0.3, 0.0]}
    assert rounded(1.00001) != rounded(1.00002)


def _row(method: str, *, valid: bool, scene: str = "tents", start: int = 0, **more: float):
    values = {"xy_error_m": 0.01, "yaw_error_deg": 2.0, "o_stab": 1.0, "objects": 4} | more
    return SceneRow.model_validate(
        {
            "scene": scene,
            "room": "tabletop",
            "tabletop": scene == "tents",
            "start": start,
            "seed": 0,
            "evaluation": start % 2 == 1,
            "method": method,
            "valid": valid,
            "check_passed": valid,
            "accepted": valid if method == "ours" else None,
            "displaced": 0,
            "noise": "layout",
            "injected": "",
            "refused": "",
            "missed": 0,
            "extra": 0,
            "s_pen": 0,
            "articulated": 0,
            "p_pen": 0,
            "s_stab": valid,
            "max_depth_m": 0.0,
            "max_drift_m": 0.0,
            "max_tilt_deg": 0.0,
            "scale_error": 0.01,
            "edge_error": 0.02,
            "box_iou": 0.9,
            "seconds_to_valid": 2.0 if valid else None,
            "seconds": 3.0,
            "rollouts": 5,
            "fingerprint": "x",
            **values,
        }
    )


def test_summary_counts_results_and_rates_difficulty():
    rows = [_row("ours", valid=True, start=k) for k in range(2)]
    rows += [_row("open_loop", valid=k == 0, start=k, xy_error_m=0.02) for k in range(2)]
    rows += [_row("gravity", valid=False, xy_error_m=0.03, o_stab=0.5)]
    rows += [_row("gravity", valid=False, scene="dominoes", o_stab=1.0, objects=12)]
    answer = summarise(rows)
    assert answer["methods"]["ours"]["n"] == 2
    # Pairs have the same scene and initial scene: gravity has one with ours.
    compared = answer["differences"]
    assert compared["to"] == "ours"
    farther = compared["methods"]["open_loop"]["xy_error_m"]
    assert (farther["n"], farther["mean"]) == (2, pytest.approx(0.02 - rows[0].xy_error_m))
    assert compared["methods"]["gravity"]["edge_error"]["n"] == 1
    # A search says what it takes for valid; gravity says nothing.
    rates = {name: of["accepted_rate"] for name, of in answer["methods"].items()}
    assert rates == {"ours": 1.0, "open_loop": None, "gravity": None}
    assert answer["methods"]["ours"]["seconds_to_valid"] == 2.0
    # Of objects: 2 of 4 and 12 of 12.
    assert answer["methods"]["gravity"]["o_stab"] == pytest.approx(14 / 16)
    # Missed ones are in no denominator but their own; extra ones can fall, too.
    own = _row("ours", valid=False, missed=1, extra=2, displaced=1)
    figures = summarise([own])["methods"]["ours"]
    assert (figures["objects"], figures["found"]) == (4, 3)
    shares = [figures[name] for name in ("displaced", "missed", "extra")]
    assert shares == pytest.approx([1 / 3, 1 / 4, 2 / 4])
    assert answer["evaluation"]["open_loop"]["valid_rate"] == 0.0
    assert not answer["difficulty"]["open_loop"]["hard_enough"]
    assert answer["difficulty"]["gravity"]["hard_enough"]
    assert answer["difficulty"]["gravity_xy_error_m"]["hard_enough"]
    assert set(BOUNDS) <= set(SceneSet.method) <= set(METHODS)


def test_tables_mark_the_papers_figures():
    rows = [_row("ours", valid=k > 0, start=k % 2, scene=s) for k, s in enumerate("ab")]
    records = list(table_records(rows))
    mean, low, high = interval(rows, "valid_rate")
    assert (mean, low, high) == pytest.approx((0.5, 0.0126, 0.9874), abs=1e-4)
    paper = [r for r in records if r["source"] == "paper"]
    assert {r["n"] for r in paper} == {30, 11} and all("valid" not in r for r in paper)
    text = markdown(records)
    assert "| NeoWorld-Pro* | 30 |" in text and "50.0 (1.3 to 98.7)" in text
    assert r"VIGA$^\ast$ & 30" in latex(records)


def test_make_refuses_an_unknown_scene_before_it_writes(tmp_path):
    with pytest.raises(SpecError, match="did you mean 'tents'"):
        make_dataset(tmp_path / "data", scenes=("tent",))
    assert not (tmp_path / "data").exists()


def test_results_folder_refuses_a_second_noise_level(tmp_path):
    row = _row("open_loop", valid=False).model_dump()
    kinds = {k: type(v) for k, v in row.items() if v is not None} | {
        "seconds_to_valid": float,
        "accepted": bool,
    }
    write_rows(tmp_path / RESULTS, [row], kinds, RunError)
    with pytest.raises(RunError, match="rows of --noise layout: take another folder"):
        run_scenes(
            ("tents",),
            ("open_loop",),
            RunSettings(0, RefineOptions(), ComposeOptions(), "exact"),
            starts=1,
            out=tmp_path,
        )


def test_warm_up_engine_simulates_one_candidate_for_all():
    scene = compile_scene(crowded(3))
    layouts = Layout.zero(5, len(scene.names))
    poses = jax.tree.map(np.asarray, scene.place(layouts))
    tilted = replace(layouts, yaw=np.full_like(np.asarray(layouts.yaw), 0.3))
    others = jax.tree.map(np.asarray, scene.place(tilted))
    mixed = jax.tree.map(lambda a, b: np.concatenate([a[:1], b[1:]]), poses, others)
    asked: list[int] = []

    class Counting(NativeEngine):
        def rollout(self, scene, poses, **options):
            asked.append(len(poses.scale))
            return super().rollout(scene, poses, **options)

    rollout = SingleCandidateEngine(Counting(1)).rollout(
        scene, mixed, duration=0.02, record_every=0.02
    )
    assert asked == [1]
    for leaf in (rollout.pos, rollout.quat, rollout.status, rollout.steps):
        assert len(leaf) == 5 and np.array_equal(leaf, np.repeat(leaf[:1], 5, axis=0))
    # Where they were placed is each candidate's own.
    assert np.array_equal(rollout.start.quat, mixed.quat)
    assert not np.array_equal(mixed.quat[0], mixed.quat[1])


def test_footprint_of_a_lid_has_rim_and_plug():
    truth = truth_scene(declarations()["nested_lids"])
    foot = underside_points(truth.object("lid_0"))
    foot = foot[np.isfinite(foot[:, 2])]
    rim = foot[:, 2] > foot[:, 2].min() + 0.005
    radius = np.linalg.norm(foot[:, :2], axis=1)
    # The jar's mouth is 43 to 48 mm from the middle, the plug 33 mm wide.
    assert np.sum(rim & (radius > 0.043) & (radius < 0.048)) >= 6
    assert np.sum(~rim & (radius < 0.034)) > 20
