"""Object tests of many objects at once: C MuJoCo on all cores, MuJoCo Warp on one GPU.

The slope scenario is left out because its contacts need other solver options. Both engines get the
same initial states and forces; times are of the simulation alone.
"""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout
from neoworld_bench.machine import machine
from neoworld_bench.rows import Row, collect, plain
from numpy.typing import NDArray

from benchmarks.suites import Battery
from neoworld_mjx.checks.scenarios import Scenario, list_scenarios
from neoworld_mjx.checks.simulation import FORCES, Simulation
from neoworld_mjx.config import VerifyOptions
from neoworld_mjx.errors import EngineError
from neoworld_mjx.spec import ObjectSpec, scale
from tests.support.valid_objects import FAMILIES, valid_objects

SIZES = (1.0, 0.8, 1.25, 1.5)
"""Scales of the valid objects, which make more than a hundred objects of them."""
NEAR_M, NEAR_DEG, NEAR = 0.002, 1.0, 0.02
"""Bounds on the difference of a final coordinate of two runs that agree: absolute, or relative to
its displacement."""
REPEATS = 3


class BatteryRow(Row):
    """Times of one engine on all objects."""

    engine: str
    objects: int
    runs: int
    """Simulations of all objects together."""
    steps: int
    """Time steps of each run."""
    models: int
    """MuJoCo models; each has as many worlds as its objects have runs."""
    threads: int | None = None
    prepare_s: float
    """Time to compile objects, initial states and forces; the same for both engines."""
    first_s: float | None = None
    """Time of the set-up and the first simulation, with compilation of kernels and graphs."""
    simulate_s: float | None = None
    """Median time of three more simulations."""
    runs_per_s: float | None = None
    same_end: float | None = None
    """Share of runs that end like C MuJoCo's: every coordinate within 2 mm, 1 degree, or 2 % of its
    displacement."""
    failed: int = 0
    """Runs whose final state is not finite."""
    status: str = "ok"


@dataclass
class Prepared:
    """A compiled object with the scenarios, initial states and forces of its runs."""

    simulation: Simulation
    runs: list[Scenario]
    starts: NDArray
    """[runs, state], each a full state in the layout of `mj_getState`."""
    forces: NDArray
    """[runs, steps, nv + 6 nbody]: on joints, then on bodies."""

    @property
    def models(self) -> list[mujoco.MjModel]:
        """Model of each run."""
        return [self.simulation.model_of(run) for run in self.runs]


def batteries(
    objects: int = 100, engines: Sequence[str] = ("native", "warp"), *, together: int = 16
) -> Iterator[BatteryRow]:
    """Time the simulation of many objects, and compare final states with those of C MuJoCo.

    Args:
        objects: number of objects; each valid object comes in four sizes.
        engines: native or warp.
        together: objects that share a model on the GPU.

    Raises:
        EngineError: fewer objects exist, or `together` of them do not fit into a model.
    """
    if not 1 <= together <= 31:
        raise EngineError(f"together: 1 to 31 objects fit into a model, not {together}")
    start = time.perf_counter()
    prepared = [prepare(spec) for spec in _objects(objects)]
    prepare_s = time.perf_counter() - start
    shared = {
        "objects": len(prepared),
        "runs": sum(len(p.runs) for p in prepared),
        "steps": prepared[0].forces.shape[1],
        "prepare_s": prepare_s,
    }
    threads = os.cpu_count() or 1
    expected: list[NDArray] | None = None
    for engine in engines:
        try:
            start = time.perf_counter()
            batch = (
                OnCores(prepared, threads) if engine == "native" else _on_gpu(prepared, together)
            )
            setup_s = time.perf_counter() - start
            ends, times = _timed(batch.run)
        except EngineError as error:
            yield BatteryRow(engine=engine, models=0, status=f"skipped: {error}", **shared)
            continue
        if engine == "native":
            expected = ends
        elif expected is None:
            expected = OnCores(prepared, threads).run()
        simulated = float(np.median(times[1:]))
        yield BatteryRow(
            engine=engine,
            models=batch.models,
            threads=threads if engine == "native" else None,
            first_s=setup_s + times[0],
            simulate_s=simulated,
            runs_per_s=shared["runs"] / simulated,
            same_end=None
            if ends is expected
            else float(np.mean(agreement(prepared, ends, expected))),
            failed=int(sum(np.sum(~np.isfinite(end).all(axis=1)) for end in ends)),
            **shared,
        )


def _on_gpu(prepared: Sequence[Prepared], together: int) -> Any:
    from neoworld_mjx.physics.warp_engine import warp_device

    device = warp_device()
    from benchmarks.battery_warp import Batch

    return Batch(prepared, together, device)


def _objects(count: int) -> list[ObjectSpec]:
    most = len(SIZES) * sum(len(family.sizes) for family in FAMILIES.values())
    if not 1 <= count <= most:
        raise EngineError(f"objects: there are {most}, not {count}")
    sound = list(valid_objects(min(count, most // len(SIZES))))
    return [spec if s == 1.0 else scale(spec, s) for s in SIZES for spec in sound][:count]


def prepare(spec: ObjectSpec, options: VerifyOptions | None = None) -> Prepared:
    """Compile an object, and its initial states and forces in all scenarios but the slope."""
    simulation = Simulation(spec, options or VerifyOptions())
    runs = list_scenarios(
        simulation.groups, simulation.joints, simulation.options, fixed_base=False
    )
    runs = [run for run in runs if run.world != "gripping"]
    # Runs without gravity come last: on the GPU they share worlds with other objects' runs.
    runs.sort(key=lambda run: run.world == "weightless")
    starts = np.array([simulation.start(run) for run in runs])
    forces = np.array([simulation.forces(run, s) for run, s in zip(runs, starts, strict=True)])
    return Prepared(simulation, runs, starts, forces)


class OnCores:
    """Simulates all runs by C MuJoCo, each object in one thread."""

    def __init__(self, prepared: Sequence[Prepared], threads: int) -> None:
        self.prepared, self.threads, self.models = prepared, threads, len(prepared)

    def run(self) -> list[NDArray]:
        """Simulate all runs; return the final qpos [runs, nq] of each object."""
        # The longest object first, so that it does not delay the last thread.
        order = sorted(self.prepared, key=lambda p: -p.forces.size)
        with ThreadPoolExecutor(self.threads) as pool:
            ends = dict(zip(map(id, order), pool.map(_roll_out, order), strict=True))
        return [ends[id(p)] for p in self.prepared]


def _roll_out(p: Prepared) -> NDArray:
    with rollout.Rollout(nthread=1) as pool:
        states, _ = pool.rollout(
            p.models,
            [mujoco.MjData(p.simulation.model)],
            p.starts,
            p.forces,
            control_spec=FORCES,
            nstep=p.forces.shape[1],
        )
    return np.array(states[:, -1, 1 : 1 + p.simulation.model.nq])


def agreement(
    prepared: Sequence[Prepared], ends: Sequence[NDArray], expected: Sequence[NDArray]
) -> NDArray[np.bool_]:
    """Return True for every run whose two final states agree."""
    agrees = []
    for p, a, b in zip(prepared, ends, expected, strict=True):
        model = p.simulation.model
        limit = np.full(model.nv, np.radians(NEAR_DEG))
        limit[:3] = NEAR_M
        for j in range(1, model.njnt):
            if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE:
                limit[model.jnt_dofadr[j]] = NEAR_M
        difference, movement = np.zeros(model.nv), np.zeros(model.nv)
        for start, end, expected_end in zip(p.starts[:, 1 : 1 + model.nq], a, b, strict=True):
            mujoco.mj_differentiatePos(model, difference, 1.0, expected_end, end)
            mujoco.mj_differentiatePos(model, movement, 1.0, start, expected_end)
            agrees.append(
                bool(np.all(np.abs(difference) < np.maximum(limit, NEAR * np.abs(movement))))
            )
    return np.array(agrees)


def _timed(run: Callable[[], list[NDArray]]) -> tuple[list[NDArray], list[float]]:
    """Run once and REPEATS times more; return the result of the last run, and all times [s]."""
    times = []
    ends: list[NDArray] = []
    for _ in range(1 + REPEATS):
        start = time.perf_counter()
        ends = run()
        times.append(time.perf_counter() - start)
    return ends, times


def run_suite(o: Battery) -> dict[str, Any]:
    """Simulate many objects at once."""
    rows = collect(batteries(o.objects, o.engine, together=o.together))
    return {"machine": machine(), "rows": plain(rows)}
