"""Time of refinement to a valid scene, its final error, and both for baselines.

The time of ours is that of the second of two runs from a start; `cold_s` is that of the first run
of a scene, with compilation. Time to valid ends with the batch of the first valid candidate.
"""

import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import EngineError, choices
from neoworld_mjx.measure import measured, passes
from neoworld_mjx.physics.engine import Engine
from neoworld_mjx.physics.exact import snap_exactly
from neoworld_mjx.physics.model import SceneModel
from neoworld_mjx.physics.simulate import open_engine
from neoworld_mjx.refinement.outcome import Refined
from neoworld_mjx.refinement.scene_refinement import compile_for_search, refine

from .methods.baselines import OneByOne, algorithm1, with_budget
from .refine_scenes import LARGE, SCENES, errors, photographed, start
from .rows import Row

BASELINES = ("algorithm1", "random", "cma_es")


class RefineRow(Row):
    """One method on one scene from one start."""

    scene: str
    objects: int
    seed: int
    method: str
    """ours, algorithm1, random or cma_es; `/plain` without gradient refinement."""
    open_loop_valid: bool
    """Whether the start is valid, snapped exactly."""
    valid: bool
    """Whether the result is valid."""
    time_to_valid_s: float | None
    """None where no candidate was valid."""
    time_total_s: float
    """Without the exact check of the winner."""
    cold_s: float | None = None
    """Time of the first run of this scene, with compilation."""
    reward: float
    """Highest absolute reward."""
    rollouts: int
    pruned: int = 0
    iterations: int | None = None
    xy_error_start_m: float
    xy_error_end_m: float
    yaw_error_start_deg: float
    yaw_error_end_deg: float
    scale_error_start: float
    scale_error_end: float
    mean_log_scale: float
    """Mean log scale of the movable objects at the end, relative to the truth."""


def refinements(
    scenes: Sequence[str] = (),
    *,
    seeds: int = 5,
    baseline_seeds: int = 1,
    baselines: Sequence[str] = BASELINES,
    options: RefineOptions | None = None,
    engine: str = "native",
) -> Iterator[RefineRow]:
    """Refine scenes from noisy starts, one row as soon as it is known.

    Args:
        scenes: names in SCENES or LARGE; none takes all of SCENES.
        seeds: starts of each scene.
        baseline_seeds: how many of them the baselines are run from.
        baselines: which.
        options: of the refinement.
        engine: that rolls candidates out; `algorithm1` has its own.

    Raises:
        EngineError: there is no such scene, or the engine cannot run here.
    """
    o = options or RefineOptions()
    plain = o.model_copy(
        update={"descent": o.descent.model_copy(update={"warm_steps": 0, "project": "never"})}
    )
    every = SCENES | LARGE
    for name in scenes or SCENES:
        if name not in every:
            raise EngineError(f"scene: {choices(name, list(every))}")
        model = compile_for_search(photographed(name), o)
        runner = open_engine(engine)  # pyright: ignore[reportArgumentType]
        cold: float | None = None
        for seed in range(seeds):
            case = _Case(name, model, seed, o)
            first = _refined(case, "ours", o, runner)[1]
            cold = first if seed == 0 else cold
            row, _ = _refined(case, "ours", o, runner)
            yield row.model_copy(update={"cold_s": cold if seed == 0 else None})
            if seed >= baseline_seeds:
                continue
            if "algorithm1" in baselines:
                # Nothing but scoring is compiled here: a run of a few candidates warms it up.
                yield _refined(case, "algorithm1", algorithm1(o), OneByOne())[0]
            compared = [method for method in ("random", "cma_es") if method in baselines]
            if not compared:
                continue
            _refined(case, "ours/plain", plain, runner)
            other, _ = _refined(case, "ours/plain", plain, runner)
            yield other
            for method in compared:
                for label, of, most in (("", o, row), ("/plain", plain, other)):
                    budget = with_budget(of, method, max(most.rollouts, 1))
                    once = budget.cem.model_copy(update={"iterations": 1})
                    _refined(
                        case, method, budget.model_copy(update={"cem": once}), runner
                    )  # compiles
                    yield _refined(case, method + label, budget, runner)[0]


class _Case:
    """A scene and one start of it."""

    def __init__(self, name: str, model: SceneModel, seed: int, o: RefineOptions) -> None:
        self.name, self.model, self.seed, self.o = name, model, seed, o
        self.start = start(model, seed)
        self.open_loop = passes(measured(snap_exactly(model.apply(self.start, 0)), o), o)

    def row(self, method: str, refined: Refined) -> RefineRow:
        """Describe the outcome of a method."""
        before, after = errors(self.model, self.start), errors(self.model, refined.layout)
        moves = np.asarray(self.model.optimised)
        to_valid = refined.seconds["to_valid"]
        return RefineRow(
            scene=self.name,
            objects=int(moves.sum()),
            seed=self.seed,
            method=method,
            open_loop_valid=self.open_loop,
            valid=refined.passed,
            time_to_valid_s=None if np.isnan(to_valid) else to_valid,
            time_total_s=refined.seconds["search"],
            reward=float(refined.history["absolute"].max()),
            rollouts=refined.rollouts,
            pruned=refined.pruned,
            iterations=refined.iterations,
            xy_error_start_m=before["xy_m"],
            xy_error_end_m=after["xy_m"],
            yaw_error_start_deg=before["yaw_deg"],
            yaw_error_end_deg=after["yaw_deg"],
            scale_error_start=before["scale"],
            scale_error_end=after["scale"],
            mean_log_scale=float(np.mean(np.asarray(refined.layout.log_scale[0])[moves])),
        )


def _refined(case: _Case, method: str, o: RefineOptions, engine: Engine) -> tuple[RefineRow, float]:
    """Refine; return the row and the seconds that the whole call took."""
    began = time.perf_counter()
    refined = refine(case.model, o, seed=case.seed, start=case.start, engine=engine)
    spent = time.perf_counter() - began
    return case.row(method, refined), spent


def summary(rows: Sequence[RefineRow]) -> dict[str, Any]:
    """Sum rows up: ours on top, the other methods under `baselines`, and rewards compared."""
    by = {method: [r for r in rows if r.method == method] for method in {r.method for r in rows}}
    answer = _figures(by.get("ours", []))
    answer["baselines"] = {
        method: _figures(by[method]) for method in sorted(by) if method != "ours"
    }
    answer["reward_higher_on"] = {
        f"{method}{how}": _wins(by.get(f"ours{how}", []), by[f"{method}{how}"])
        for method in ("algorithm1", "random", "cma_es")
        for how in ("", "/plain")
        if f"{method}{how}" in by
    }
    return answer


def _figures(rows: Sequence[RefineRow]) -> dict[str, Any]:
    median = lambda xs: float(np.median(xs)) if len(xs) else None
    mean = lambda xs: float(np.mean(xs)) if len(xs) else None
    names = ("xy_error_start_m", "xy_error_end_m", "yaw_error_start_deg", "yaw_error_end_deg")
    names += ("scale_error_start", "scale_error_end", "mean_log_scale", "reward", "rollouts")
    return {
        "n": len(rows),
        "valid_rate": mean([r.valid for r in rows]),
        "open_loop_valid_rate": mean([r.open_loop_valid for r in rows]),
        "time_to_valid_s": median([r.time_to_valid_s for r in rows if r.time_to_valid_s]),
        "never_valid": sum(r.time_to_valid_s is None for r in rows),
        "time_total_s": median([r.time_total_s for r in rows]),
        "cold_s": median([r.cold_s for r in rows if r.cold_s is not None]),
        "pruned": mean([r.pruned for r in rows]),
        **{name: mean([getattr(r, name) for r in rows]) for name in names},
    }


def _wins(ours: Sequence[RefineRow], others: Sequence[RefineRow]) -> dict[str, Any]:
    """On how many scenes our mean absolute reward is the higher one, over the seeds both ran."""
    gains: dict[str, list[float]] = {}
    own = {(r.scene, r.seed): r.reward for r in ours}
    for r in others:
        if (r.scene, r.seed) in own:
            gains.setdefault(r.scene, []).append(own[r.scene, r.seed] - r.reward)
    ahead = [scene for scene, gain in gains.items() if np.mean(gain) > 0]
    return {"scenes": len(ahead), "of": len(gains), "behind": sorted(set(gains) - set(ahead))}
