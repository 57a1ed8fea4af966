"""The battery's runs of many objects at once: C MuJoCo on all cores beside MuJoCo Warp on one GPU.

Of the battery only the slope is left out, whose contacts are of another kind. Both sides get the
same starts and forces, and what they are timed on is simulation alone.
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
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from benchmarks.suites import Battery
from neoworld_mjx.bench.machine import machine
from neoworld_mjx.bench.rows import collect, plain
from neoworld_mjx.config import VerifyOptions
from neoworld_mjx.errors import EngineError
from neoworld_mjx.spec import ObjectSpec, scale
from neoworld_mjx.verify.scenarios import Scenario, list_scenarios
from neoworld_mjx.verify.simulation import FORCES, Simulation
from tests.support.sound import FAMILIES, sound_objects

SIZES = (1.0, 0.8, 1.25, 1.5)
"""Sizes that the sound objects are tried in, so that there are a hundred of them."""
NEAR_M, NEAR_DEG, NEAR = 0.002, 1.0, 0.02
"""How near each other two runs of the same scenario end that count as the same: so far, or this
share of
how far that coordinate went."""
REPEATS = 3


class BatteryRow(BaseModel):
    """One engine on all objects."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    engine: str
    objects: int
    runs: int
    """Of all objects together."""
    steps: int
    """Of each run."""
    models: int
    """That the objects are put into; each has as many worlds as its objects have runs."""
    threads: int | None = None
    prepare_s: float
    """Compiling objects, starts and forces; for both engines the same."""
    first_s: float | None = None
    """Setting up and the first time, with compiling kernels and graphs."""
    simulate_s: float | None = None
    """Median of three more."""
    runs_per_s: float | None = None
    same_end: float | None = None
    """Share of runs that end where C MuJoCo's do: every coordinate within 2 mm, 1 degree, or 2 % of
    how
    far it went."""
    failed: int = 0
    """Runs that ended in no number."""
    status: str = "ok"


@dataclass
class Prepared:
    """An object with all that its runs need."""

    trial: Simulation
    runs: list[Scenario]
    starts: NDArray
    """[runs, state] as MuJoCo lays a full state out."""
    forces: NDArray
    """[runs, steps, nv + 6 nbody], on joints, then on bodies."""

    @property
    def models(self) -> list[mujoco.MjModel]:
        """The model of each run."""
        return [self.trial.model_of(run) for run in self.runs]


def batteries(
    objects: int = 100, engines: Sequence[str] = ("native", "warp"), *, together: int = 16
) -> Iterator[BatteryRow]:
    """Time the runs of many objects, and hold their ends against C MuJoCo's.

    Args:
        objects: how many; there are four sizes of each sound object.
        engines: native or warp.
        together: objects that share a model on the GPU; their worlds are the same.

    Raises:
        EngineError: there are not so many objects, or so many do not fit into a model.
    """
    if not 1 <= together <= 31:
        raise EngineError(f"together: 1 to 31 objects fit into a model, not {together}")
    began = time.perf_counter()
    prepared = [prepare(spec) for spec in _objects(objects)]
    spent = time.perf_counter() - began
    known = {
        "objects": len(prepared),
        "runs": sum(len(p.runs) for p in prepared),
        "steps": prepared[0].forces.shape[1],
        "prepare_s": spent,
    }
    threads = os.cpu_count() or 1
    expected: list[NDArray] | None = None
    for engine in engines:
        try:
            began = time.perf_counter()
            batch = (
                OnCores(prepared, threads) if engine == "native" else _on_gpu(prepared, together)
            )
            made = time.perf_counter() - began
            ends, times = _timed(batch.run)
        except EngineError as error:
            yield BatteryRow(engine=engine, models=0, status=f"skipped: {error}", **known)
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
            first_s=made + times[0],
            simulate_s=simulated,
            runs_per_s=known["runs"] / simulated,
            same_end=None if ends is expected else float(np.mean(same(prepared, ends, expected))),
            failed=int(sum(np.sum(~np.isfinite(end).all(axis=1)) for end in ends)),
            **known,
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
    sound = list(sound_objects(min(count, most // len(SIZES))))
    return [spec if s == 1.0 else scale(spec, s) for s in SIZES for spec in sound][:count]


def prepare(spec: ObjectSpec, options: VerifyOptions | None = None) -> Prepared:
    """Compile an object, and make starts and forces of all its runs but the slope."""
    trial = Simulation(spec, options or VerifyOptions())
    runs = list_scenarios(trial.groups, trial.joints, trial.options, fixed_base=False)
    runs = [run for run in runs if run.world != "gripping"]
    # Those without gravity last: on the GPU they share worlds with those of other objects.
    runs.sort(key=lambda run: run.world == "weightless")
    starts = np.array([trial.start(run) for run in runs])
    forces = np.array([trial.forces(run, s) for run, s in zip(runs, starts, strict=True)])
    return Prepared(trial, runs, starts, forces)


class OnCores:
    """All runs by C MuJoCo, an object a thread."""

    def __init__(self, prepared: Sequence[Prepared], threads: int) -> None:
        self.prepared, self.threads, self.models = prepared, threads, len(prepared)

    def run(self) -> list[NDArray]:
        """Simulate all runs; return qpos at the end [runs, nq] of each object."""
        # The longest first, so that no thread is left with it at the end.
        order = sorted(self.prepared, key=lambda p: -p.forces.size)
        with ThreadPoolExecutor(self.threads) as pool:
            found = dict(zip(map(id, order), pool.map(_roll_out, order), strict=True))
        return [found[id(p)] for p in self.prepared]


def _roll_out(p: Prepared) -> NDArray:
    with rollout.Rollout(nthread=1) as pool:
        states, _ = pool.rollout(
            p.models,
            [mujoco.MjData(p.trial.model)],
            p.starts,
            p.forces,
            control_spec=FORCES,
            nstep=p.forces.shape[1],
        )
    return np.array(states[:, -1, 1 : 1 + p.trial.model.nq])


def same(
    prepared: Sequence[Prepared], ends: Sequence[NDArray], expected: Sequence[NDArray]
) -> NDArray[np.bool_]:
    """Tell for every run whether two rollouts of it end in the same place."""
    told = []
    for p, a, b in zip(prepared, ends, expected, strict=True):
        model = p.trial.model
        limit = np.full(model.nv, np.radians(NEAR_DEG))
        limit[:3] = NEAR_M
        for j in range(1, model.njnt):
            if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE:
                limit[model.jnt_dofadr[j]] = NEAR_M
        away, went = np.zeros(model.nv), np.zeros(model.nv)
        for start, x, y in zip(p.starts[:, 1 : 1 + model.nq], a, b, strict=True):
            mujoco.mj_differentiatePos(model, away, 1.0, y, x)
            mujoco.mj_differentiatePos(model, went, 1.0, start, y)
            told.append(bool(np.all(np.abs(away) < np.maximum(limit, NEAR * np.abs(went)))))
    return np.array(told)


def _timed(run: Callable[[], list[NDArray]]) -> tuple[list[NDArray], list[float]]:
    """Run once and REPEATS times more; return what the last found, and all times."""
    times = []
    ends: list[NDArray] = []
    for _ in range(1 + REPEATS):
        began = time.perf_counter()
        ends = run()
        times.append(time.perf_counter() - began)
    return ends, times


def answer(o: Battery) -> dict[str, Any]:
    """Simulate many objects at once."""
    rows = collect(batteries(o.objects, o.engine, together=o.together))
    return {"machine": machine(), "rows": plain(rows)}
