"""Ablations as methods, and what is counted of the objects: P-Pen and what curves need."""

import pytest

from neoworld_mjx.bench.dataset.part_depths import P_PEN_M, articulated, part_depth
from neoworld_mjx.bench.dataset.scene_methods import ABLATIONS, SEARCHES
from neoworld_mjx.bench.dataset.scene_objects import FAR, object_rows
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
from neoworld_mjx.sweeps.plan import Ablation, points, read

LABELS = {
    "without_s_sem": "without S_sem",
    "without_d_pen": "without D_pen",
    "without_d_drift": "without D_drift",
    "no_simulation": "without simulation",
}


def test_ablations_switch_what_the_projects_ablations_switch():
    by_label = {p.label: p.options for p in points(read("configs/ablations/refine.yaml", Ablation))}
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


def test_parts_that_enter_their_parent_count():
    free, deep = drawer(0.001), drawer(-0.003)
    assert articulated(free)
    assert part_depth(free) == 0.0
    assert part_depth(deep) == pytest.approx(0.003, abs=1e-6) and part_depth(deep) > P_PEN_M


def test_rows_of_objects_keep_what_curves_need():
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
    assert object_rows(scene, lost, key)[0].drift_m == FAR
