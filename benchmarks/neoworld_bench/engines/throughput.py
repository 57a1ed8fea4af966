"""Candidates per second of each engine, and agreement of its verdicts with C MuJoCo.

Every row runs in a process of its own, which is stopped at its time limit. A row whose verdicts
disagree with MuJoCo has no rates.
"""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import jax
import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from neoworld_mjx.engines import EngineName
from neoworld_mjx.errors import EngineError
from neoworld_mjx.physics.engine import EarlyStop, Rollout, RolloutStatus, open_engine
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.spec import SceneSpec, read_scene

from ..rows import Row
from .table_scenes import noisy_layouts
from .verdicts import Loop, compare, motion, naive_loop

COMPARED = 128
"""Number of candidates on which the loop is timed and verdicts are compared."""
REPEATS = 5
"""Maximum number of rollouts over which the rate is the median."""
LEAST_AGREEMENT, MOST_FAILED = 0.9, 0.01
"""Least agreement of verdicts and largest share of failed candidates of a row with a rate."""
START_S = 60.0
"""Time for a row's process to start and compile the scene [s], in addition to its limit."""


class EngineTask(BaseModel):
    """Conditions of one row."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    engine: EngineName
    population: int = Field(ge=1)
    early_stop: bool = False
    duration_s: float = 1.0
    seed: int = 0
    budget_s: float = 60.0


class EngineRow(Row):
    """Rate and agreement of an engine on a scene; None where a column was not reached."""

    scene: str
    objects: int
    """Number of objects, supports included."""
    engine: str
    population: int
    devices: int
    early_stop: bool
    candidates_per_s: float | None = None
    loop_candidates_per_s: float
    """Rate of MuJoCo on one thread, with each candidate's scene recompiled."""
    compile_s: float | None = None
    """Time of the first rollout minus that of a steady one: tracing, compilation, cold caches."""
    steps_per_s: float | None = None
    """Rate of simulated steps, without those of stopped candidates."""
    agreement: float | None = None
    """Share of verdicts equal to those of MuJoCo on recompiled scenes, without borderline layouts,
    which move 0.5 to 2 times a bound."""
    agreement_near_bound: float | None = None
    """The same of the borderline layouts."""
    compared: int = 0
    stable_share: float | None = None
    failed_share: float | None = None
    status: str = "ok"
    """ok, or `skipped:` or `invalid:` with the reason."""


class EngineMeasurement(BaseModel):
    """Measurements of one row from its process."""

    model_config = ConfigDict(extra="forbid", ser_json_inf_nan="strings")

    first_s: float
    steady_s: list[float]
    mean_steps: float
    failed_share: float
    stable_share: float
    motion: list[float]
    """Largest motion of the first candidates, in units of the bounds."""


def engine_rows(
    name: str, scene: SceneSpec, tasks: Sequence[EngineTask], *, apart: bool = True
) -> Iterator[EngineRow]:
    """Measure engines on a scene; yield rows as they complete.

    Args:
        name: of the scene, for the rows.
        scene: the scene; candidates are noisy layouts about it.
        tasks: conditions of the rows; all have the same seed and duration.
        apart: True to measure in separate processes; otherwise in this one, without a time limit.
    """
    model, first = compile_scene(scene), tasks[0]
    layouts = noisy_layouts(model, COMPARED, seed=first.seed)
    poses = model.place_exactly(layouts)
    loop = naive_loop(model, layouts, poses, duration=first.duration_s, budget=first.budget_s)
    for task in tasks:
        result = in_a_process(scene, task) if apart else measure(scene, task)
        yield _row(name, len(scene.objects), task, loop, result)


def _row(
    name: str, objects: int, task: EngineTask, loop: Loop, result: EngineMeasurement | str
) -> EngineRow:
    row = EngineRow(
        scene=name,
        objects=objects,
        engine=task.engine,
        population=task.population,
        devices=len(jax.devices()),
        early_stop=task.early_stop,
        loop_candidates_per_s=loop.candidates_per_s,
    )
    if isinstance(result, str):
        return row.model_copy(update={"status": result})
    n = min(len(loop.motion), len(result.motion))
    verdicts = compare(loop.motion[:n], np.array(result.motion[:n]))
    share = verdicts.share(near=False)
    update: dict[str, object] = {
        "agreement": share,
        "agreement_near_bound": verdicts.share(near=True),
        "compared": n,
        "stable_share": result.stable_share,
        "failed_share": result.failed_share,
    }
    if result.failed_share > MOST_FAILED or (share is not None and share < LEAST_AGREEMENT):
        why = f"{result.failed_share:.1%} failed, verdicts agree in {share or 0:.1%}"
        return row.model_copy(update={**update, "status": f"invalid: {why}"})
    if not result.steady_s:
        return row.model_copy(update={**update, "status": "skipped: budget"})
    steady = float(np.median(result.steady_s))
    update |= {
        "candidates_per_s": task.population / steady,
        "compile_s": max(result.first_s - steady, 0.0),
        "steps_per_s": result.mean_steps * task.population / steady,
    }
    return row.model_copy(update=update)


def in_a_process(scene: SceneSpec, task: EngineTask) -> EngineMeasurement | str:
    """Measure in a new process; return the reason if it is stopped or fails."""
    with tempfile.TemporaryDirectory() as folder:
        given, out = Path(folder) / "scene.json", Path(folder) / "row.json"
        given.write_text(scene.to_json(), encoding="utf-8")
        command = [sys.executable, "-m", __name__, task.model_dump_json(), str(given), str(out)]
        limit = task.budget_s + START_S
        try:
            process = subprocess.run(command, capture_output=True, text=True, timeout=limit)
        except subprocess.TimeoutExpired:
            return "skipped: budget"
        if not out.exists():
            last_line = (process.stderr.strip().splitlines() or ["no message"])[-1]
            return f"skipped: process ended with {process.returncode}: {last_line[:200]}"
        result = json.loads(out.read_text(encoding="utf-8"))
    return result if isinstance(result, str) else EngineMeasurement.model_validate(result)


def measure(scene: SceneSpec, task: EngineTask) -> EngineMeasurement | str:
    """Time one engine on one population in this process, or return why it cannot run."""
    start = time.perf_counter()
    try:
        engine = open_engine(task.engine)
        model = compile_scene(scene)
        layouts = jax.device_put(noisy_layouts(model, task.population, seed=task.seed))
        rule = EarlyStop() if task.early_stop else None

        def once() -> Rollout:
            poses = model.place(layouts)
            rollout = engine.rollout(model, poses, duration=task.duration_s, early_stop=rule)
            return jax.block_until_ready(rollout)

        began = time.perf_counter()
        rollout = once()
        first = time.perf_counter() - began
    except EngineError as error:
        return f"skipped: {error}"
    steady: list[float] = []
    while len(steady) < REPEATS and time.perf_counter() - start < task.budget_s:
        steady.append(_seconds(once))
    engine_motion = motion(model, rollout)
    return EngineMeasurement(
        first_s=first,
        steady_s=steady,
        mean_steps=float(np.mean(rollout.steps)),
        failed_share=float(np.mean(np.asarray(rollout.status) == RolloutStatus.FAILED)),
        stable_share=float(np.mean(engine_motion < 1.0)),
        motion=[float(x) for x in engine_motion[:COMPARED]],
    )


def _seconds(call: Callable[[], object]) -> float:
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def main() -> None:
    """Measure the task given as JSON on the scene of a file, and write the result to a file."""
    task = EngineTask.model_validate_json(sys.argv[1])
    result = measure(read_scene(Path(sys.argv[2])), task)
    text = json.dumps(result) if isinstance(result, str) else result.model_dump_json()
    Path(sys.argv[3]).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
