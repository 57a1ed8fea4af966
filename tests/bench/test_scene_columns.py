"""Ablations as methods, rows of objects for P-Pen, and curves over thresholds."""

import pytest
from neoworld_bench.methods.part_depths import P_PEN_M, articulated, part_depth
from neoworld_bench.methods.scene_methods import ABLATIONS, SEARCHES
from neoworld_bench.methods.scene_objects import MOTION_CAP, ObjectRow, object_rows
from neoworld_bench.tables.scene_curves import CURVES, curve_records, curves_csv, curves_svg
from neoworld_bench.tables.scene_summary import ratio_interval

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.measure import SceneMeasure
from neoworld_mjx.spec import (
    Box,
    GeomSpec,
    JointSpec,
    Material,
    ObjectSpec,
    PartSpec,
    SceneObject,
    SceneSpec,
)
from neoworld_mjx.sweeps.plan import Ablation, points, read_plan

LABELS = {
    "without_s_sem": "without S_sem",
    "without_d_pen": "without D_pen",
    "without_d_drift": "without D_drift",
    "no_simulation": "without simulation",
}


def test_ablation_methods_match_the_configured_ablations():
    by_label = {
        p.label: p.options for p in points(read_plan("configs/ablations/refine.yaml", Ablation))
    }
    assert set(LABELS) == set(ABLATIONS)
    for method, label in LABELS.items():
        changed = SEARCHES[method](RefineOptions())
        assert changed == by_label[label] != RefineOptions()


def drawer(gap: float) -> ObjectSpec:
    """Return two walls and a board that slides between them, `gap` m away from either."""
    shape = lambda name, size, y: GeomSpec(
        name=name, shape=Box(size=size), pos=(0.0, y, 0.05), material="oak"
    )
    walls = tuple(shape(f"wall_{k}", (0.2, 0.01, 0.1), y) for k, y in enumerate((-0.105, 0.105)))
    board = shape("plank", (0.18, 0.2 - 2 * gap, 0.05), 0.0)
    slide = JointSpec(
        name="slide", type="prismatic", parent="walls", child="board",
        axis=(1.0, 0.0, 0.0), lower=0.0, upper=0.1,
    )  # fmt: skip
    return ObjectSpec(
        name="drawer",
        materials=(Material(name="oak", density=700.0),),
        parts=(PartSpec(name="walls", geoms=walls), PartSpec(name="board", geoms=(board,))),
        joints=(slide,),
    )


def test_p_pen_counts_parts_that_penetrate_their_parent():
    free, deep = drawer(0.001), drawer(-0.003)
    assert articulated(free)
    assert part_depth(free) == 0.0
    assert part_depth(deep) == pytest.approx(0.003, abs=1e-6) and part_depth(deep) > P_PEN_M


def test_object_rows_have_drift_tilt_and_depths():
    scene = SceneSpec(
        objects=(
            SceneObject(name="floor", spec=drawer(0.001), environment=True),
            SceneObject(name="chest", spec=drawer(-0.003), parent="floor"),
            SceneObject(name="other", spec=drawer(0.001), parent="floor", fixed_base=True),
        )
    )
    measure = SceneMeasure(
        objects=3,
        movable=1,
        s_pen=0,
        max_depth_m=5e-4,
        settled_depth_m=0.0,
        depths_m={"floor|chest": 2e-4, "chest|other": 5e-4},
        s_stab=True,
        max_drift_m=0.02,
        max_tilt_deg=1.0,
        drift_m={"chest": 0.02},
        tilt_deg={"chest": 1.0},
        duration_s=2.0,
    )
    key = ("tents", 1, 0, "ours")
    chest, other = object_rows(scene, measure, key)
    assert chest.key == key and (chest.drift_m, chest.tilt_deg, chest.depth_m) == (0.02, 1.0, 5e-4)
    assert chest.part_depth_m == pytest.approx(0.003, abs=1e-6)
    assert (other.drift_m, other.depth_m, other.part_depth_m) == (None, 5e-4, 0.0)
    lost = measure.model_copy(update={"drift_m": {"chest": float("nan")}})
    assert object_rows(scene, lost, key)[0].drift_m == MOTION_CAP


def test_curves_count_at_every_threshold():
    def row(scene: str, name: str, drift: float | None, tilt: float, depth: float, parts=None):
        return ObjectRow(
            scene=scene, start=0, seed=0, method="ours", object=name, drift_m=drift,
            tilt_deg=None if drift is None else tilt, depth_m=depth, part_depth_m=parts,
        )  # fmt: skip

    objects = [
        row("tents", "a", 0.002, 1.0, 5e-4),
        row("tents", "b", 0.02, 1.0, 0.0, 2e-3),
        row("dominoes", "c", 0.002, 7.0, 0.0, 0.0),
        row("dominoes", "d", None, 0.0, 3e-3),
    ]
    records = curve_records(objects)

    def share(measure: str, over: str, threshold: float) -> tuple[float, int]:
        return next(
            (r["share"], r["n"])
            for r in records
            if (r["measure"], r["over"], r["threshold"]) == (measure, over, threshold)
        )

    # What cannot move has no stability, but may enter others.
    assert share("O-Stab", "drift_m", 0.01) == (pytest.approx(1 / 3), 3)
    assert share("O-Stab", "drift_m", 0.1) == (pytest.approx(2 / 3), 3)
    assert share("S-Stab", "drift_m", 0.1) == (0.5, 2)
    assert share("S-Stab", "tilt_deg", 50.0) == (0.5, 2)
    assert share("S-Stab", "tilt_deg", 5.0) == (0.0, 2)
    assert share("S-Pen", "depth_m", 1e-4) == (1.0, 2)
    assert share("S-Pen", "depth_m", 1e-3) == (0.5, 2)
    assert share("P-Pen", "depth_m", 1e-3) == (0.5, 2) and share("P-Pen", "depth_m", 0.01)[0] == 0
    assert all(curve.table in curve.thresholds for curve in CURVES)
    assert curves_csv(records).count("\n") == 1 + sum(len(c.thresholds) for c in CURVES)
    drawn = curves_svg(records)
    assert drawn is not None and "P-Pen [%]" in drawn and "ours" in drawn


def test_shares_of_empty_sets_are_none():
    assert ratio_interval([("a", 0.0, 0.0)]) == (None, None, None)
    mean, low, high = ratio_interval([("a", 1.0, 1.0), ("b", 0.0, 0.0)])
    assert (mean, low, high) == (1.0, None, None)
