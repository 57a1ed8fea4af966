"""Comparison of one device with several."""

import pytest
from neoworld_bench.methods import device_scaling
from neoworld_bench.methods.device_scaling import (
    Scaled,
    ScalingTask,
    device_counts,
    in_a_process,
    measure,
    scaling,
    scaling_tasks,
    visible_devices,
)

from neoworld_mjx.errors import EngineError
from neoworld_mjx.physics.native import NativeEngine


def scaled(seconds, verdicts, values, objects=6):
    return Scaled(
        seconds=seconds,
        compile_s=1.0,
        candidates=100,
        objects=objects,
        parts={"devices": 1.5, "host": 0.5},
        device_peak_mib=[10.0, 11.0],
        verdicts=verdicts,
        values=values,
    )


@pytest.mark.parametrize(
    ("largest", "counts"), [(1, (1,)), (2, (1, 2)), (6, (1, 2, 4, 6)), (8, (1, 2, 4, 8))]
)
def test_counts_double_up_to_all_devices(largest, counts):
    assert device_counts(largest) == counts


def test_rows_are_compared_with_the_first_of_the_same_work():
    tasks = scaling_tasks((1, 2), (6, 20), 100, None, repeats=3, seed=0)
    measured = {
        (6, 1): scaled([4.0, 9.0, 3.0], [1, 0, 1, 1], [0.5, 2.0, float("nan"), 0.1]),
        (6, 2): scaled([2.0], [1, 0, 0, 1], [0.5, 2.1, float("nan"), 0.1]),
        (20, 1): "skipped: budget",
        (20, 2): scaled([8.0], [1], [0.2], objects=20),
    }
    rows = list(scaling(tasks, lambda task: measured[task.objects, task.devices]))
    assert [(row.objects, row.devices) for row in rows] == [(6, 1), (6, 2), (20, 1), (20, 2)]
    assert [row.speedup for row in rows] == [1.0, 2.0, None, 1.0]
    assert [row.candidates_per_s for row in rows] == [25.0, 50.0, None, 12.5]
    assert (rows[1].equal_verdicts, rows[1].equal_values) == (0.75, 0.75)
    assert rows[1].device_peak_mib == "10, 11" and rows[2].status == "skipped: budget"


def test_a_process_sees_the_devices_of_its_row():
    assert visible_devices(2, {}, "gpu") == {"CUDA_VISIBLE_DEVICES": "0,1"}
    assert visible_devices(2, {"CUDA_VISIBLE_DEVICES": "5,3,1"}, "gpu") == {
        "CUDA_VISIBLE_DEVICES": "5,3"
    }
    flags = visible_devices(4, {"XLA_FLAGS": "--a=1"}, "cpu")["XLA_FLAGS"]
    assert flags == "--a=1 --xla_force_host_platform_device_count=4"


def test_a_row_without_its_devices_is_refused():
    task = ScalingTask(work="rollouts", devices=64, population=4, objects=1)
    with pytest.raises(EngineError, match="64 requested"):
        measure(task)


def test_a_process_is_stopped_at_its_time_limit():
    task = ScalingTask(work="rollouts", devices=1, population=4, objects=0)
    assert in_a_process(task, 0.01) == "skipped: budget"


@pytest.mark.slow
def test_a_sweep_is_timed_by_part(monkeypatch):
    monkeypatch.setattr(device_scaling, "MjxEngine", NativeEngine)
    task = ScalingTask(
        work="sweep", devices=1, population=16, points=2, seeds=2, iterations=2, repeats=0
    )
    result = measure(task)
    assert result.candidates == 4 * 2 * 16
    assert len(result.values) == 4 and set(result.verdicts) <= {0, 1}
    assert set(result.parts) == {"propose", "rollout", "score", "check", "deliver", "other"}
    assert sum(result.parts.values()) == pytest.approx(result.seconds[0] + result.compile_s)
