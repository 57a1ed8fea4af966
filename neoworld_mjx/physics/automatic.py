"""The engine `auto`: each rollout runs on the available engine with the least predicted cost."""

import os
import time
import weakref
from collections.abc import Mapping

import jax

from ..errors import EngineError
from .engine import EarlyStop, Engine, Rollout, record_steps
from .engine_costs import read_costs, scene_class, write_costs
from .guidance import Guidance
from .layout import Poses
from .model import SceneModel, StaticScene


class AutomaticEngine:
    """Engine that delegates each rollout to the engine with the least cost on this machine.

    Small populations run on the CPU and large populations on the accelerator. The crossover depends
    on the scene and the machine. Two engines may give different verdicts for values within a factor
    of 2 of a threshold, so `name` lists the engines used.
    """

    def __init__(self, engines: Mapping[str, Engine]) -> None:
        """Select among `engines`, a map from names to opened engines."""
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        self._engines = dict(engines)
        self._machine = f"{jax.devices()[0].device_kind}, {cores} cores"
        self._costs = read_costs(self._machine, cores or 1)
        self._started: weakref.WeakKeyDictionary[StaticScene, set[str]] = (
            weakref.WeakKeyDictionary()
        )
        self._refused: weakref.WeakKeyDictionary[StaticScene, set[str]] = (
            weakref.WeakKeyDictionary()
        )
        self.name = "auto"
        """Names of the engines used so far, joined by "+"; `auto` before the first rollout."""
        self._used: list[str] = []
        self.refusals: list[str] = []
        """Reasons why engines could not simulate a scene, one line each."""

    def rollout(
        self,
        scene: SceneModel,
        poses: Poses,
        *,
        duration: float = 1.0,
        record_every: float = 0.1,
        early_stop: EarlyStop | None = None,
        guidance: Guidance | None = None,
    ) -> Rollout:
        """Simulate every candidate on the engine of least predicted cost; see `Engine.rollout`."""
        records, every = record_steps(scene.static.mjm.opt.timestep, duration, record_every)
        steps, candidates = records * every, poses.scale.shape[0]
        model = scene.static.mjm
        cost_class = scene_class(len(scene.names), model.ngeom, early_stop=early_stop is not None)
        started = self._started_with(scene.static)
        refused = self._refused.setdefault(scene.static, set())
        while remaining := [name for name in self._engines if name not in refused]:
            seconds = {
                name: self._costs[name].predict(
                    cost_class, candidates, steps, started=name in started
                )
                for name in remaining
            }
            name = min(remaining, key=seconds.__getitem__)
            begin = time.perf_counter()
            try:
                rollout = jax.block_until_ready(
                    self._engines[name].rollout(
                        scene,
                        poses,
                        duration=duration,
                        record_every=record_every,
                        early_stop=early_stop,
                        guidance=guidance,
                    )
                )
            except EngineError as error:
                refused.add(name)
                self.refusals.append(f"{name} cannot simulate this scene: {error}")
                continue
            elapsed = time.perf_counter() - begin
            self._costs[name].add(cost_class, candidates, steps, elapsed, started=name in started)
            started.add(name)
            if name not in self._used:
                self._used.append(name)
                self.name = "+".join(self._used)
            write_costs(self._machine, self._costs)
            return rollout
        raise EngineError("; ".join(self.refusals) or "no engine can run here")

    def _started_with(self, static: StaticScene) -> set[str]:
        """Return the engines that already simulated a scene, with or without damped joints."""
        known = (names for other, names in self._started.items() if other.spec is static.spec)
        return self._started.setdefault(static, next(known, set()))
