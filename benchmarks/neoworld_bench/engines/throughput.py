"""Candidates per second of each engine, compared with the naive loop and a bare MJX scan.

Every row runs in a separate process, which gives its peak memory and can be stopped at its time
limit. A row whose verdicts disagree with the naive loop has no rates.
"""

import functools
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from neoworld_mjx.engines import ENGINES, EngineName
from neoworld_mjx.errors import EngineError
from neoworld_mjx.physics.engine import EarlyStop, Rollout, RolloutStatus
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.model import SceneModel, compile_scene
from neoworld_mjx.physics.simulate import open_engine

from ..machine import Others, peak_mib
from ..rows import Row
from ..unfinished_runs import KeptRows
from .bare_scan import bare_scan
from .table_scenes import COUNTS, crowded, noisy_layouts
from .verdicts import Loop, compare, motion, naive_loop

NAIVE_CANDIDATES = 128
"""Number of candidates on which the naive loop is timed and verdicts are compared."""
REPEATS = 5
"""Maximum number of rollouts over which the steady rate is the median."""
SANE_AGREEMENT, SANE_FAILED = 0.9, 0.01
"""Least agreement of verdicts and largest share of failed candidates of a row with a rate."""
_START_S = 30.0
"""Time limit for a row's process to start and compile the scene [s]."""


class Task(BaseModel):
    """Conditions of one row."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    engine: EngineName
    objects: int = Field(ge=1)
    population: int = Field(ge=1)
    early_stop: bool = False
    duration_s: float = 1.0
    seed: int = 0
    budget_s: float = 60.0


class PhysicsRow(Row):
    """Row of the table; None if a column does not apply or was not reached."""

    engine: str
    objects: int
    population: int
    steps: int
    """Time steps of a full rollout."""
    early_stop: bool
    candidates_per_s: float | None = None
    naive_candidates_per_s: float | None = None
    bare_scan_candidates_per_s: float | None = None
    """Rate of `jax.vmap` over `mjx.step` alone, with the same batched fields; engine mjx only."""
    core_ms: float | None = None
    """Processor time per candidate over all threads [ms]; engine native only. Other processes do
    not affect it."""
    naive_core_ms: float | None = None
    compile_s: float | None = None
    """Time of the first rollout minus that of a steady one: tracing, compilation, cold caches."""
    first_s: float | None = None
    steady_s: float | None = None
    """Median of `repeats` rollouts."""
    repeats: int = 0
    steps_per_s: float | None = None
    """Rate of simulated steps, without those of stopped candidates."""
    mean_steps: float | None = None
    single_thread_steps_per_s: float | None = None
    """Rate of `mj_step` in the naive loop."""
    peak_mib: float | None = None
    """Peak resident memory of the row's process, imports included."""
    device_peak_mib: float | None = None
    others_cores: float | None = None
    """Mean number of cores used by other processes while this row was timed."""
    verdict_agreement: float | None = None
    """Agreement with the naive loop over `compared` layouts, including those near a bound."""
    verdict_agreement_clear: float | None = None
    """The same without borderline layouts, which move 0.5 to 2 times a bound."""
    compared: int = 0
    stable_share: float | None = None
    failed_share: float | None = None
    status: str = "ok"
    """ok, or `skipped:` or `invalid:` with the reason."""


class Measured(BaseModel):
    """Measurements of one row from its process."""

    model_config = ConfigDict(extra="forbid", ser_json_inf_nan="strings")

    first_s: float
    steady_s: list[float]
    core_s: list[float]
    """Processor time of each steady rollout."""
    bare_scan_s: list[float] = []
    mean_steps: float
    failed_share: float
    stable_share: float
    motion: list[float]
    """Largest motion of the first candidates, in units of the bounds."""
    peak_mib: float
    device_peak_mib: float | None
    others_cores: float | None


def physics(
    objects: Sequence[int] = COUNTS,
    populations: Sequence[int] = (1024,),
    engines: Sequence[str] = tuple(ENGINES),
    *,
    early_stop: Sequence[bool] = (False, True),
    duration: float = 1.0,
    budget: float = 60.0,
    seed: int = 0,
    apart: bool = True,
    kept: KeptRows | None = None,
) -> Iterator[PhysicsRow]:
    """Measure engines; yield rows as they complete.

    Args:
        objects: numbers of objects on the table.
        populations: numbers of candidates.
        engines: names of engines.
        early_stop: values of early stopping to measure.
        duration: simulated time [s].
        budget: time limit of a row, and of the naive loop for a scene [s].
        seed: of scenes and layouts.
        apart: True to measure in separate processes; otherwise in this one, without a time limit.
        kept: rows of an interrupted run.
    """
    kept = kept or KeptRows(None)

    @functools.cache
    def naive(count: int) -> Loop:
        scene = compile_scene(crowded(count, seed=seed))
        pop = min(max(populations), NAIVE_CANDIDATES)
        layouts = noisy_layouts(scene, pop, seed=seed)
        poses = scene.place_exactly(layouts)
        return naive_loop(scene, layouts, poses, duration=duration, budget=budget)

    for count in objects:
        for engine in engines:
            for population in populations:
                for stop in early_stop:
                    task = Task.model_validate(
                        {
                            "engine": engine,
                            "objects": count,
                            "population": population,
                            "early_stop": stop,
                            "duration_s": duration,
                            "seed": seed,
                            "budget_s": budget,
                        }
                    )

                    def measured(task: Task = task) -> list[PhysicsRow]:
                        return [_row(task, naive(task.objects), apart=apart)]

                    yield from kept.rows(task.model_dump_json(), measured)


def _row(task: Task, naive: Loop, *, apart: bool) -> PhysicsRow:
    row = PhysicsRow(
        engine=task.engine,
        objects=task.objects,
        population=task.population,
        steps=naive.steps,
        early_stop=task.early_stop,
        naive_candidates_per_s=naive.candidates_per_s,
        single_thread_steps_per_s=naive.steps_per_s,
        naive_core_ms=1e3 * naive.cpu_s / len(naive.motion),
    )
    result = _in_a_process(task) if apart else measure(task)
    if isinstance(result, str):
        return row.model_copy(update={"status": result})
    compared = min(len(naive.motion), task.population)
    verdicts = compare(naive.motion[:compared], np.array(result.motion[:compared]))
    checked = {
        "verdict_agreement": float(verdicts.same.mean()),
        "verdict_agreement_clear": verdicts.share(near=False),
        "compared": compared,
        "stable_share": result.stable_share,
        "failed_share": result.failed_share,
        "peak_mib": result.peak_mib,
        "device_peak_mib": result.device_peak_mib,
        "others_cores": result.others_cores,
    }
    clear = checked["verdict_agreement_clear"]
    if result.failed_share > SANE_FAILED or (clear is not None and clear < SANE_AGREEMENT):
        why = f"invalid: {result.failed_share:.1%} failed, verdicts agree in {clear or 0:.1%}"
        return row.model_copy(update={**checked, "status": why})
    if not result.steady_s:
        late = {"first_s": result.first_s, "status": "skipped: budget"}
        return row.model_copy(update={**checked, **late})
    steady = float(np.median(result.steady_s))
    bare_scan_s = float(np.median(result.bare_scan_s)) if result.bare_scan_s else None
    core = 1e3 * float(np.median(result.core_s)) / task.population
    rates = {
        "core_ms": core if task.engine == "native" else None,
        "candidates_per_s": task.population / steady,
        "bare_scan_candidates_per_s": None
        if bare_scan_s is None
        else task.population / bare_scan_s,
        "compile_s": max(result.first_s - steady, 0.0),
        "first_s": result.first_s,
        "steady_s": steady,
        "repeats": len(result.steady_s),
        "steps_per_s": result.mean_steps * task.population / steady,
        "mean_steps": result.mean_steps,
    }
    return row.model_copy(update={**checked, **rates})


def _in_a_process(task: Task) -> Measured | str:
    """Measure in a new process; return the reason if it is stopped or fails."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "row.json"
        command = [sys.executable, "-m", __name__, task.model_dump_json(), str(out)]
        try:
            process = subprocess.run(
                command, capture_output=True, text=True, timeout=task.budget_s + _START_S
            )
        except subprocess.TimeoutExpired:
            return "skipped: budget"
        if not out.exists():
            last_line = (process.stderr.strip().splitlines() or ["no message"])[-1]
            return f"skipped: process ended with {process.returncode}: {last_line[:200]}"
        result = json.loads(out.read_text(encoding="utf-8"))
    return result if isinstance(result, str) else Measured.model_validate(result)


def measure(task: Task) -> Measured | str:
    """Time one engine on one population, in this process.

    Returns:
        Measurements, or the reason why the row was skipped.
    """
    start = time.perf_counter()
    try:
        engine = open_engine(task.engine)
    except EngineError as error:
        return f"skipped: {error}"
    scene = compile_scene(crowded(task.objects, seed=task.seed))
    layouts = jax.device_put(noisy_layouts(scene, task.population, seed=task.seed))
    rule = EarlyStop() if task.early_stop else None

    def once() -> Rollout:
        poses = scene.place(layouts)
        rollout = engine.rollout(scene, poses, duration=task.duration_s, early_stop=rule)
        return jax.block_until_ready(rollout)

    try:
        t0 = time.perf_counter()
        rollout = once()
        first = time.perf_counter() - t0
    except EngineError as error:
        return f"skipped: {error}"
    steady: list[float] = []
    core: list[float] = []
    others = Others()
    remaining = lambda: task.budget_s - (time.perf_counter() - start)
    while len(steady) < REPEATS and remaining() > (steady[-1] if steady else 0.0):
        t0, c0 = time.perf_counter(), time.process_time()
        rollout = once()
        steady.append(time.perf_counter() - t0)
        core.append(time.process_time() - c0)
    disturbed = others.cores()
    engine_motion = motion(scene, rollout)
    host, device = peak_mib()
    bare_scan_times = []
    if task.engine == "mjx" and not task.early_stop:
        bare_scan_times = _time_bare(scene, layouts, rollout, task, remaining())
    return Measured(
        first_s=first,
        steady_s=steady,
        core_s=core,
        bare_scan_s=bare_scan_times,
        mean_steps=float(np.mean(rollout.steps)),
        failed_share=float(np.mean(np.asarray(rollout.status) == RolloutStatus.FAILED)),
        stable_share=float(np.mean(engine_motion < 1.0)),
        motion=[float(x) for x in engine_motion[:NAIVE_CANDIDATES]],
        peak_mib=host,
        device_peak_mib=device,
        others_cores=disturbed,
    )


def _time_bare(
    scene: SceneModel, layouts: Layout, rollout: Rollout, task: Task, budget_s: float
) -> list[float]:
    """Time the bare scan as often as time allows; not at all if a rollout took too long."""
    ends = time.perf_counter() + budget_s
    steps = round(task.duration_s / scene.static.mjm.opt.timestep)
    once = bare_scan(scene, layouts, steps)
    jax.block_until_ready(once())
    times: list[float] = []
    while len(times) < REPEATS and time.perf_counter() + (times[-1] if times else 0.0) < ends:
        t0 = time.perf_counter()
        jax.block_until_ready(once())
        times.append(time.perf_counter() - t0)
    return times


def main() -> None:
    """Measure a task given as JSON, and write the result to a file."""
    task = Task.model_validate_json(sys.argv[1])
    result = measure(task)
    text = json.dumps(result) if isinstance(result, str) else result.model_dump_json()
    Path(sys.argv[2]).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
