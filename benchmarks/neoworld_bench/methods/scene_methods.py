"""Methods that turn an initial scene into a layout: the search, its ablations, and baselines."""

import dataclasses
import functools
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from neoworld_mjx.config import AlignOptions, RefineOptions, list_options, merged
from neoworld_mjx.errors import SpecError, choices
from neoworld_mjx.evidence.evidence import Evidence
from neoworld_mjx.measure import SceneMeasure, measured
from neoworld_mjx.physics.colliders import snap_exactly
from neoworld_mjx.physics.engine import Engine
from neoworld_mjx.physics.layout import Poses
from neoworld_mjx.physics.model import compile_for_simulation
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.physics.rest import settle_scene
from neoworld_mjx.pipeline.place import LayoutEstimate, refine_placed
from neoworld_mjx.search.searched_scene import compile_for_search
from neoworld_mjx.spec import SceneSpec

from ..noise.initial_scenes import InitialScene

GRAVITY_S = 3.0
"""Duration of the fall of the method `gravity` [s]."""


@dataclass(frozen=True)
class MethodResult:
    """Result of a method."""

    scene: SceneSpec
    measure: SceneMeasure
    seconds_to_result: float | None
    """Time until the first candidate that the search accepts [s]. If there is none, and for methods
    without a search, it equals `seconds`."""
    seconds: float | None
    """Time of the method [s]; None for a submission."""
    rollouts: int = 0
    accepted: bool | None = None
    """Verdict of the search; None for methods without a search."""


def ours(o: RefineOptions) -> RefineOptions:
    """Return the options unchanged."""
    return o


def changed(o: RefineOptions, change: dict[str, Any]) -> RefineOptions:
    """Return options with the changes in a nested dict."""
    return RefineOptions.model_validate(merged(o.model_dump(mode="json"), change))


def algorithm1(o: RefineOptions) -> RefineOptions:
    """Return the options of Algorithm 1, with the paper's value of every option that differs.

    They are the options of configs/paper.yaml, except that S_sem is geometric.
    """
    values: dict[str, Any] = {}
    for option in list_options(RefineOptions):
        if option.difference is None or option.path.startswith("semantic."):
            continue
        group = values
        *groups, name = option.path.split(".")
        for part in groups:
            group = group.setdefault(part, {})
        group[name] = option.difference.value
    return changed(o, values)


ABLATIONS: dict[str, dict[str, Any]] = {
    "without_s_sem": {"reward": {"w_sem": 0.0}},
    "without_d_pen": {"reward": {"w_pen": 0.0}},
    "without_d_drift": {"reward": {"w_drift": 0.0}},
    "no_simulation": {
        "rollout": {"duration_s": 0.0},
        "settle": {"enabled": False},
        "finalists": 1,
    },
}
"""Changes of the refinement's options in each ablation, as in configs/ablations/refine.yaml."""
EVIDENCE: dict[str, AlignOptions] = {
    "without_photo": AlignOptions(enabled=False),
    "without_contours": AlignOptions(contours=False),
    "without_edges": AlignOptions(edges=False),
    "without_final": AlignOptions(final=False),
}
"""Options of the alignment with the photograph in each of its ablations."""
SEARCHES: dict[str, Callable[[RefineOptions], RefineOptions]] = {
    "ours": ours,
    "random": partial(changed, change={"optimizer": "random"}),
    **dict.fromkeys(("algorithm1", "algorithm1_aligned"), algorithm1),
    **{name: partial(changed, change=change) for name, change in ABLATIONS.items()},
    **dict.fromkeys(EVIDENCE, ours),
}
"""Methods that are a refinement, with the function that changes its options."""
UNALIGNED = ("open_loop", "gravity", "guided", "algorithm1")
"""Methods that start from the composed scene; all others first align it with the photograph."""
METHODS = ("open_loop", "aligned", "gravity", "guided", *SEARCHES)
"""Names of all methods."""


def _gravity(composed: SceneSpec, _: RefineOptions) -> SceneSpec:
    """Let a scene fall freely for GRAVITY_S."""
    world = compile_for_simulation(snap_exactly(composed))
    start = world.poses()
    end = NativeEngine().rollout(world, start, duration=GRAVITY_S, record_every=GRAVITY_S)
    return world.scene_at(Poses(end.pos[:, -1], end.quat[:, -1], start.scale, start.height))


SETTLED: dict[str, Callable[[SceneSpec, RefineOptions], SceneSpec]] = {
    **dict.fromkeys(("open_loop", "aligned"), lambda start, o: snap_exactly(start)),
    "gravity": _gravity,
    "guided": lambda composed, o: settle_scene(composed, o.settle),
}
"""Methods without a search. Objects are snapped to their supports, fall freely, or settle with
guidance. `aligned` aligns the scene with the photograph before."""


def outcome_of(
    method: str,
    start: SceneSpec,
    o: RefineOptions,
    engine: Engine,
    *,
    seed: int = 0,
    evidence: Evidence | None = None,
    again: AlignOptions | None = None,
) -> MethodResult:
    """Run a method from an initial scene.

    Args:
        method: name from METHODS.
        start: the initial scene.
        o: options of the refinement and of the final check.
        engine: engine that rolls out the candidates.
        seed: random seed of the search.
        evidence: the photograph, for the final alignment and for a search whose S_sem is a model's,
            and what is known, for the final alignment.
        again: options of the final alignment; if None, there is none.
    """
    if method in SETTLED:
        began = time.perf_counter()
        scene = SETTLED[method](start, o)
        spent = time.perf_counter() - began
        return MethodResult(scene, measured(scene, o), spent, spent)
    options = SEARCHES[method](o)
    model, known = compile_for_search(start, options), evidence or Evidence()
    began = time.perf_counter()
    placed = refine_placed(
        start,
        options,
        seed=seed,
        engine=engine,
        photo=known.photo,
        again=again,
        evidence=known,
        model=model,
    )
    spent, refined = time.perf_counter() - began, placed.refined
    to_valid = refined.seconds["to_valid"]
    return MethodResult(
        placed.scene,
        placed.measure,
        # A candidate that coarse rollouts accept but the final check rejects is not valid; the
        # result that replaces it is known only at the end.
        float(to_valid) if refined.passed and not np.isnan(to_valid) else spent,
        spent,
        refined.rollouts,
        refined.passed,
    )


def outcomes_of(
    methods: Sequence[str],
    initial: InitialScene,
    o: RefineOptions,
    engine: Engine,
    evidence: Callable[[], Evidence],
    *,
    align: AlignOptions,
    seed: int = 0,
) -> Iterator[tuple[str, MethodResult]]:
    """Run methods from one initial scene, and yield each name with its result.

    Args:
        methods: names, as for `outcome_of`.
        initial: the noisy response and its objects.
        o: options of the refinement and of the final check.
        engine: engine that rolls out the candidates.
        evidence: function that returns the photograph and the other evidence.
        align: options of the alignment.
        seed: random seed of the searches.
    """
    placed: dict[AlignOptions, LayoutEstimate] = {}
    given = functools.cache(evidence)

    @functools.cache
    def composed() -> SceneSpec:
        if given().camera is None:
            return initial.scene
        return initial.placed(dataclasses.replace(given(), photo=None)).scene

    for method in methods:
        used = EVIDENCE.get(method, align)
        aligns = used.enabled and method not in UNALIGNED
        start, spent = composed(), 0.0
        if aligns:
            # The final alignment has no part in the start.
            key = used.model_copy(update={"final": True})
            if key not in placed:
                placed[key] = initial.placed(given(), key)
            start, spent = placed[key].scene, placed[key].seconds
        result = outcome_of(
            method,
            start,
            o,
            engine,
            seed=seed,
            evidence=None if method in SETTLED else given(),
            again=used if aligns else None,
        )
        times = {
            name: value + spent
            for name in ("seconds", "seconds_to_result")
            if (value := getattr(result, name)) is not None
        }
        yield method, dataclasses.replace(result, **times)


def check_methods(methods: Sequence[str], others: Sequence[str] = ()) -> None:
    """Check the names of methods.

    Args:
        methods: the names.
        others: further names that are methods.

    Raises:
        SpecError: a name is not a method.
    """
    for method in methods:
        if method not in (*METHODS, *others):
            raise SpecError(f"method: {choices(method, (*METHODS, *others))}")
