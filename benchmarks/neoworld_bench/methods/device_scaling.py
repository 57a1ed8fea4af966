"""Rollouts and a sweep on one device and on several: rates, memory, and equality of results.

JAX fixes the devices of a process when it starts. Every row therefore runs in a process that sees
only the devices of this row: GPUs selected by CUDA_VISIBLE_DEVICES, or simulated devices of a CPU.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from neoworld_mjx.compilations import compiled
from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import EngineError
from neoworld_mjx.physics.engine import Rollout, record_steps
from neoworld_mjx.physics.layout import Poses
from neoworld_mjx.physics.mjx_engine import MjxEngine, bare_scan, prepare
from neoworld_mjx.physics.model import SceneModel, compile_scene
from neoworld_mjx.refinement.compiling import compile_for_search
from neoworld_mjx.refinement.search_run import SearchRun
from neoworld_mjx.spec import read_scene
from neoworld_mjx.sweeps.cases import Case
from neoworld_mjx.sweeps.group_runs import search_together

from ..engines.table_scenes import crowded, noisy_layouts
from ..engines.verdicts import motion
from ..machine import peak_device_mib
from ..photographs.real_scenes import FOLDER
from ..rows import Row
from .baselines import algorithm1

EQUAL = 1e-3
"""Maximum difference of two values that count as equal."""
WEIGHTS = (0.25, 4.0)
"""Smallest and largest weight of D_drift over the points of the sweep."""


class ScalingTask(BaseModel):
    """Conditions of one row."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    work: Literal["rollouts", "sweep"]
    devices: int = Field(ge=1)
    population: int = Field(ge=1)
    """Number of candidates of a rollout, or of each iteration of a search."""
    objects: int = Field(default=0, ge=0)
    points: int = Field(default=0, ge=0)
    seeds: int = Field(default=0, ge=0)
    iterations: int = Field(default=0, ge=0)
    repeats: int = Field(default=3, ge=0)
    """Number of timed calls after the first call. If 0, the first call is timed, without its
    compilation."""
    seed: int = 0


class ScalingRow(Row):
    """Row of the table."""

    work: str
    devices: int
    objects: int
    """Number of objects on the table, or in the sweep's scene."""
    population: int
    runs: int = 0
    seconds: float | None = None
    """Median time over the repeats, without compilation [s]."""
    candidates_per_s: float | None = None
    speedup: float | None = None
    """`seconds` of the first row of the same work divided by `seconds` of this row."""
    parts: str = ""
    """Time of each part [s]. For rollouts, `devices` is the time of the simulation on the devices,
    and `host` is the rest."""
    compile_s: float | None = None
    device_peak_mib: str = ""
    """Peak memory of each device [MiB]."""
    equal_verdicts: float | None = None
    """Fraction of the candidates, or of the winners of searches, with the same verdict as in the
    first row of the same work."""
    equal_values: float | None = None
    """Fraction of the candidates (winners) whose value differs from the first row by at most EQUAL.
    The value is the motion in units of the bounds for candidates, and the reward for winners."""
    status: str = "ok"
    """Reason why the row was skipped, or "ok"."""


class Scaled(BaseModel):
    """Measurements of one row, made in its process."""

    model_config = ConfigDict(extra="forbid", ser_json_inf_nan="strings")

    seconds: list[float]
    compile_s: float
    candidates: int
    objects: int
    parts: dict[str, float]
    device_peak_mib: list[float]
    verdicts: list[int]
    """For each candidate, 1 if it is stable; for each winner, 1 if it passes the final check."""
    values: list[float]
    """Motion of each candidate in units of the bounds, or the reward of each winner."""


def device_counts(largest: int) -> tuple[int, ...]:
    """Return the powers of two below `largest`, and `largest`."""
    counts = [2**k for k in range(largest.bit_length()) if 2**k < largest]
    return (*counts, largest)


def scaling_tasks(
    devices: Sequence[int],
    objects: Sequence[int],
    population: int,
    sweep: tuple[int, int, int, int] | None,
    *,
    repeats: int,
    seed: int,
) -> list[ScalingTask]:
    """Return the tasks of the table, in order.

    Args:
        devices: numbers of devices.
        objects: numbers of objects in the scenes of the rollouts.
        population: number of candidates of a rollout.
        sweep: points, seeds, population and iterations of the sweep. If None, there is no sweep.
        repeats: number of timed rollouts after the first.
        seed: seed of scenes and layouts.
    """
    tasks = [
        ScalingTask(
            work="rollouts",
            devices=count,
            population=population,
            objects=number,
            repeats=repeats,
            seed=seed,
        )
        for number in objects
        for count in devices
    ]
    if sweep is not None:
        points, seeds, candidates, iterations = sweep
        tasks += [
            ScalingTask(
                work="sweep",
                devices=count,
                population=candidates,
                points=points,
                seeds=seeds,
                iterations=iterations,
                repeats=0,
                seed=seed,
            )
            for count in devices
        ]
    return tasks


def scaling(
    tasks: Sequence[ScalingTask], run: Callable[[ScalingTask], Scaled | str]
) -> Iterator[ScalingRow]:
    """Measure tasks one by one, and yield each row as soon as it is complete.

    Tasks that differ only in `devices` are compared with the first of them.

    Args:
        tasks: conditions of the rows.
        run: function that measures a task, or returns the reason why the task was skipped; see
            `in_a_process`.
    """
    first: dict[str, Scaled] = {}
    for task in tasks:
        result = run(task)
        row = ScalingRow(
            work=task.work,
            devices=task.devices,
            objects=task.objects,
            population=task.population,
            runs=task.points * task.seeds,
        )
        if isinstance(result, str):
            yield row.model_copy(update={"status": result})
            continue
        base = first.setdefault(task.model_copy(update={"devices": 1}).model_dump_json(), result)
        seconds = float(np.median(result.seconds))
        same = np.array(result.verdicts) == np.array(base.verdicts)
        values, others = np.array(result.values), np.array(base.values)
        near = np.isclose(values, others, rtol=0.0, atol=EQUAL, equal_nan=True)
        yield row.model_copy(
            update={
                "objects": result.objects,
                "seconds": seconds,
                "candidates_per_s": result.candidates / seconds,
                "speedup": float(np.median(base.seconds)) / seconds,
                "parts": ", ".join(f"{name} {value:.2f}" for name, value in result.parts.items()),
                "compile_s": result.compile_s,
                "device_peak_mib": ", ".join(f"{mib:.0f}" for mib in result.device_peak_mib),
                "equal_verdicts": float(np.mean(same)),
                "equal_values": float(np.mean(near)),
            }
        )


def in_a_process(task: ScalingTask, budget: float) -> Scaled | str:
    """Measure a task in a new process within a time limit.

    Args:
        task: the task.
        budget: time limit [s].

    Returns:
        The measurements, or the reason why there are none.
    """
    environment = os.environ | visible_devices(task.devices, os.environ, jax.default_backend())
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "row.json"
        command = [sys.executable, "-m", __name__, task.model_dump_json(), str(out)]
        try:
            process = subprocess.run(
                command, capture_output=True, text=True, timeout=budget, env=environment
            )
        except subprocess.TimeoutExpired:
            return "skipped: budget"
        if not out.exists():
            last_line = (process.stderr.strip().splitlines() or ["no message"])[-1]
            return f"skipped: process ended with {process.returncode}: {last_line[:200]}"
        return Scaled.model_validate(json.loads(out.read_text(encoding="utf-8")))


def visible_devices(devices: int, environment: Mapping[str, str], backend: str) -> dict[str, str]:
    """Return the environment variables with which a process sees a number of devices."""
    if backend == "cpu":
        flags = environment.get("XLA_FLAGS", "")
        return {"XLA_FLAGS": f"{flags} --xla_force_host_platform_device_count={devices}".strip()}
    visible = environment.get("CUDA_VISIBLE_DEVICES", "").split(",")
    chosen = visible[:devices] if any(visible) else [str(k) for k in range(devices)]
    return {"CUDA_VISIBLE_DEVICES": ",".join(chosen)}


def measure(task: ScalingTask) -> Scaled:
    """Measure a task in this process.

    Raises:
        EngineError: JAX has a different number of devices.
    """
    if len(jax.devices()) != task.devices:
        raise EngineError(f"devices: {task.devices} requested, JAX has {len(jax.devices())}")
    return _rollouts(task) if task.work == "rollouts" else _sweep(task)


def _rollouts(task: ScalingTask) -> Scaled:
    engine = MjxEngine()
    scene = compile_scene(crowded(task.objects, seed=task.seed))
    poses = jax.device_get(scene.place(noisy_layouts(scene, task.population, seed=task.seed)))
    seconds, compile_s, rollout = _timed(lambda: engine.rollout(scene, poses), task.repeats)
    records, every = record_steps(scene.static.mjm.opt.timestep, 1.0, 0.1)
    alone = _scan_alone(engine, scene, poses, records, every)
    engine_motion = motion(scene, rollout)
    return Scaled(
        seconds=seconds,
        compile_s=compile_s,
        candidates=task.population,
        objects=task.objects,
        parts={"devices": alone, "host": float(np.median(seconds)) - alone},
        device_peak_mib=peak_device_mib(),
        verdicts=[int(x) for x in engine_motion < 1.0],
        values=[float(x) for x in engine_motion],
    )


def _scan_alone(
    engine: MjxEngine, scene: SceneModel, poses: Poses, records: int, every: int
) -> float:
    """Return the time of the jitted simulation of one chunk, times the number of chunks [s]."""
    model, scene = engine.on_devices(scene)
    size = engine.chunk(model, len(poses.scale))
    split = engine.split(jax.tree.map(lambda x: np.asarray(x[:size], np.float32), poses))
    fields, start, _ = prepare(scene, split)
    scan = lambda: bare_scan(model, fields, start, records, every, mesh=engine.mesh)
    seconds, _, _ = _timed(scan, 0)  # The rollouts have already compiled the function.
    return seconds[0] * -(-len(poses.scale) // size)


def _sweep(task: ScalingTask) -> Scaled:
    """Search the composed scene of the bundled photograph by Algorithm 1, all runs together."""
    spec = read_scene(FOLDER / "coffee.json")
    plain = algorithm1(RefineOptions())
    cem = {"population": task.population, "iterations": task.iterations, "stop_gain": 0.0}
    o = plain.model_copy(
        update={
            "cem": plain.cem.model_copy(update=cem),
            "rollout": plain.rollout.model_copy(update={"engine": "mjx"}),
        }
    )
    weights = np.geomspace(*WEIGHTS, task.points)
    weighted = [
        o.model_copy(update={"reward": o.reward.model_copy(update={"w_drift": float(w)})})
        for w in weights
    ]
    runs = [SearchRun(w, seed) for w in weighted for seed in range(task.seeds)]
    case, model, engine = Case("coffee", spec), compile_for_search(spec, o), MjxEngine()
    clock: dict[str, float] = {}

    def once() -> list[dict[str, Any]]:
        clock.clear()
        return search_together(case, o, model, runs, engine, clock)

    seconds, compile_s, rows = _timed(once, task.repeats)
    parts = {name: clock[name] for name in ("propose", "rollout", "score", "check", "deliver")}
    parts["other"] = seconds[-1] + compile_s - sum(parts.values())
    return Scaled(
        seconds=seconds,
        compile_s=compile_s,
        candidates=sum(row["rollouts"] for row in rows),
        objects=len(spec.objects),
        parts=parts,
        device_peak_mib=peak_device_mib(),
        verdicts=[int(row["passed"]) for row in rows],
        values=[float(row["candidate_reward"]) for row in rows],
    )


def _timed(call: Callable[[], Any], repeats: int) -> tuple[list[float], float, Any]:
    """Return the times of repeated calls, the compilation time of the first call, and a result.

    Without repeats, the time of the first call is returned, without its compilation.
    """
    before, began = compiled().seconds, time.perf_counter()
    result: Rollout | Any = jax.block_until_ready(call())
    compile_s = compiled().seconds - before
    seconds = [] if repeats else [time.perf_counter() - began - compile_s]
    for _ in range(repeats):
        began = time.perf_counter()
        result = jax.block_until_ready(call())
        seconds.append(time.perf_counter() - began)
    return seconds, compile_s, result


def main() -> None:
    """Measure the task given as JSON in the first argument; write the result to the second."""
    result = measure(ScalingTask.model_validate_json(sys.argv[1]))
    Path(sys.argv[2]).write_text(result.model_dump_json(), encoding="utf-8")


if __name__ == "__main__":
    main()
