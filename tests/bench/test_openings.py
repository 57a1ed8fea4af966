"""Openings of joints: opened scenes of the benchmark, initial scenes, and the summary."""

import pytest
from neoworld_bench.dataset.declaration import declaration
from neoworld_bench.dataset.truth_scene import truth_scene
from neoworld_bench.methods.joint_openings import (
    OPENINGS,
    STAGES,
    OpeningRow,
    initial_scene,
    opening_summary,
    with_boxes,
    with_closed,
    with_open,
)


def row(errors, *, start=0, scene="a", deviation=0.1):
    """A row with a range of 2 and errors of its opening by stage."""
    zero = {"xy_error_m": 0.01, "yaw_error_deg": 1.0, "scale_error": 0.02}
    return OpeningRow(
        scene=scene,
        object="chest",
        joint="lid",
        start=start,
        range=2.0,
        truth=1.0,
        value={stage: 1.0 + off for stage, off in zip(STAGES, errors, strict=True)},
        deviation=deviation,
        errors=dict.fromkeys(STAGES, zero),
    )


def test_the_summary_counts_joints_that_are_unknowns():
    rows = [
        row((0.4, 0.4, -0.1)),
        row((0.2, 0.2, 0.4), start=1, scene="b"),
        row((0.3, 0.3, 0.3), deviation=None),
    ]
    summary = opening_summary(rows)
    assert (summary["n"], summary["joints"]) == (2, 2)
    aligned = summary["table"][-1]
    assert aligned["stage"] == "aligned" and aligned["position_mm"] == pytest.approx(10.0)
    assert aligned["opening_percent"] == pytest.approx(12.5)
    assert summary["aligned_minus_without"]["opening_percent"][0] == pytest.approx(-2.5)


def test_a_joint_of_the_benchmark_is_opened_and_its_initial_scene_has_errors():
    declared = truth_scene(declaration("desk_drawers"))
    chest = declared.object("chest")
    closed, opened = (chest.spec.joint(f"drawer_{k}_slide") for k in (1, 2))
    assert with_open(declared, chest, opened) == declared
    scene = with_boxes(with_open(declared, chest, closed))
    value = scene.object("chest").joint_state[closed.name]
    assert OPENINGS[0] * closed.upper <= value <= OPENINGS[1] * closed.upper
    shut = with_closed(scene, chest, closed)
    assert shut.object("chest").joint_state[closed.name] == 0.0
    first, second = (initial_scene(scene, 3, programs=False) for _ in range(2))
    assert first == second
    wrong = first.object("chest").joint_state[closed.name]
    assert wrong != value and 0 <= wrong <= 1.1 * closed.upper
