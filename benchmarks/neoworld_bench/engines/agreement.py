"""Agreement of engines with MuJoCo on the same layouts.

Four checks: (a) a candidate's model equals the recompiled scaled model; (b) `native` equals
`mj_step` on it bit by bit; (c) its motion equals that of the recompiled model until chaos separates
them; (d) verdicts are equal.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from neoworld_mjx.engines import ENGINES
from neoworld_mjx.errors import EngineError, choices
from neoworld_mjx.physics.engine import EarlyStop
from neoworld_mjx.physics.exact import snap_exactly
from neoworld_mjx.physics.layout import Layout, Poses
from neoworld_mjx.physics.mjcf import to_mjspec
from neoworld_mjx.physics.model import FREE, SceneModel, compile_scene
from neoworld_mjx.physics.native import open_batch
from neoworld_mjx.physics.simulate import open_engine

from ..rows import Row
from .agreement_scenes import AGREEMENT
from .field_comparison import SINGLE, field_errors, loose_fields
from .table_scenes import noisy_layouts
from .verdicts import compare, motion, naive_loop, started

FIRST_STEP, FIRST_STEP_SHARE = 1e-6, 0.95
"""Largest difference after one step [m] or [rad], and the share of layouts that must keep it."""
NUDGE = 1e-13
"""Perturbation far below the resolution of any contact [m]."""
BIT_STEPS, FALL_STEPS, FALL = 100, 100, 2.0
"""Steps compared bit by bit, steps of the contact-free fall, and clearance under objects [m]."""


class ModelRow(Row):
    """Results of checks (a) to (c) of one scene."""

    scene: str
    layouts: int
    stable_share: float
    field_error: float
    """Largest relative difference of fields in double precision."""
    field_error_single: float
    """The same for fields that MuJoCo stores in single precision."""
    loose_fields: list[str]
    """Fields beyond 1e-9, or beyond 1e-6 in single precision."""
    bit_equal_share: float
    """Share of layouts whose native trajectory is that of mj_step to the last bit."""
    first_step_share: float
    """Share of layouts within 1e-6 m of the recompiled model after one step."""
    first_step_control: float
    """The same for the recompiled model and itself started 1e-13 m away: the effect of chaos."""
    fall_error_m: float
    """Largest difference from the recompiled model throughout a fall without contact."""
    passed: bool
    """True if fields, bits and fall agree; `first_step_share` is checked over all scenes."""


class VerdictRow(Row):
    """Result of check (d) of one scene and engine."""

    scene: str
    engine: str
    early_stop: bool
    layouts: int
    stable_share: float
    near_bound: int
    """Layouts that move 0.5 to 2 times a bound; not part of `agreement`."""
    agreement: float | None
    """Share of equal verdicts among the others."""
    agreement_near_bound: float | None
    wanted: float
    passed: bool | None
    """None if the engine cannot run."""
    note: str = ""


def agreement(
    scenes: Sequence[str] = (),
    engines: Sequence[str] = ("native",),
    *,
    layouts: int = 64,
    seed: int = 0,
) -> Iterator[ModelRow | VerdictRow]:
    """Compare engines with MuJoCo on recompiled scenes; yield rows as they complete.

    Args:
        scenes: names in `AGREEMENT`; none selects all six.
        engines: engines whose verdicts are compared.
        layouts: candidates of each scene.
        seed: of the layouts.

    Raises:
        EngineError: a scene is unknown.
    """
    for name in chosen_scenes(scenes):
        make, noise = AGREEMENT[name]
        # With a clearance: rounding would decide whether objects at zero distance touch.
        scene = compile_scene(snap_exactly(make()))
        sampled = noisy_layouts(scene, layouts, seed=seed, noise=noise)
        poses = scene.place_exactly(sampled)
        reference = naive_loop(scene, sampled, poses).motion
        yield _models(name, scene, sampled, poses, float(np.mean(reference < 1)))
        for engine in engines:
            for rule in (None, EarlyStop()):
                yield _verdicts(name, scene, poses, reference, engine, rule)


def chosen_scenes(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names, all if there are none; raise an EngineError if a scene is unknown."""
    for name in names:
        if name not in AGREEMENT:
            raise EngineError(f"scene: {choices(name, list(AGREEMENT))}")
    return tuple(names or AGREEMENT)


def agreed(rows: Sequence[ModelRow | VerdictRow]) -> dict[str, Any]:
    """Summarize rows: shares over all layouts, and whether all engines that ran agree.

    Returns:
        "passed", "first_step_share" with its control, and under "agreement" the share of equal
        verdicts of each engine, with and without early stop.
    """
    models = [row for row in rows if isinstance(row, ModelRow)]
    verdicts = [row for row in rows if isinstance(row, VerdictRow) and row.passed is not None]
    mean = lambda values: float(np.mean(values)) if values else None
    first = mean([row.first_step_share for row in models])
    by_engine = {}
    for row in verdicts:
        label = f"{row.engine}, early stop" if row.early_stop else row.engine
        by_engine.setdefault(label, []).append(row)
    shares = {label: _share(rows_of) for label, rows_of in by_engine.items()}
    enough = all(shares[label] >= rows_of[0].wanted for label, rows_of in by_engine.items())
    return {
        "passed": enough
        and all(row.passed for row in models)
        and (first is None or first >= FIRST_STEP_SHARE),
        "first_step_share": first,
        "first_step_control": mean([row.first_step_control for row in models]),
        "agreement": shares,
    }


def _share(rows: Sequence[VerdictRow]) -> float:
    counts = [row.layouts - row.near_bound for row in rows]
    same = [(row.agreement or 0.0) * n for row, n in zip(rows, counts, strict=True)]
    return float(sum(same) / max(sum(counts), 1))


def _verdicts(
    name: str,
    scene: SceneModel,
    poses: Poses,
    reference: np.ndarray,
    engine: str,
    rule: EarlyStop | None,
) -> VerdictRow:
    wanted = ENGINES[engine].agreement
    about = {"scene": name, "engine": engine, "early_stop": rule is not None, "wanted": wanted}
    try:
        engine_motion = motion(scene, open_engine(engine).rollout(scene, poses, early_stop=rule))
    except EngineError as error:
        engine_motion, note = None, str(error)
    else:
        note = ""
    verdicts = compare(reference, reference if engine_motion is None else engine_motion)
    share = None if engine_motion is None else verdicts.share(near=False)
    return VerdictRow(
        **about,
        layouts=len(reference),
        stable_share=float(verdicts.stable.mean()),
        near_bound=int(verdicts.near.sum()),
        agreement=share,
        agreement_near_bound=None if engine_motion is None else verdicts.share(near=True),
        passed=None if engine_motion is None else share is not None and share >= wanted,
        note=note,
    )


class _Differences(NamedTuple):
    fields: dict[str, float]
    bits: bool
    first: float
    control: float
    fall: float


def _models(name: str, scene: SceneModel, layouts: Layout, poses: Poses, stable: float) -> ModelRow:
    batch = open_batch(scene, poses)
    start = batch.bind("qpos").copy()
    models = [batch.get_model(k) for k in range(batch.nsim)]
    batch.step(nstep=BIT_STEPS)
    differences = []
    for k, model in enumerate(models):
        spec = to_mjspec(scene.apply(layouts, k, poses), timestep=model.opt.timestep)
        recompiled, data = started(spec)
        differences.append(_differences(model, start[k], batch.bind("qpos")[k], recompiled, data))
    errors = {n: max(d.fields[n] for d in differences) for n in differences[0].fields}
    bits = float(np.mean([d.bits for d in differences]))
    within = lambda gaps: float(np.mean([gap <= FIRST_STEP for gap in gaps]))
    fall, loose = max(d.fall for d in differences), sorted(loose_fields(errors))
    return ModelRow(
        scene=name,
        layouts=len(differences),
        stable_share=stable,
        field_error=max(e for n, e in errors.items() if n not in SINGLE),
        field_error_single=max(e for n, e in errors.items() if n in SINGLE),
        loose_fields=loose,
        bit_equal_share=bits,
        first_step_share=within([d.first for d in differences]),
        first_step_control=within([d.control for d in differences]),
        fall_error_m=fall,
        passed=not loose and bits == 1 and fall <= FIRST_STEP,
    )


def _differences(
    model: mujoco.MjModel,
    start: np.ndarray,
    end: np.ndarray,
    recompiled: mujoco.MjModel,
    fresh: mujoco.MjData,
) -> _Differences:
    """Compare a candidate's model with the recompiled one, and its native final state with
    mj_step."""
    data = mujoco.MjData(model)
    data.qpos[:] = start
    mujoco.mj_step(model, data)
    composed = fresh.qpos.copy()
    mujoco.mj_step(recompiled, fresh)
    nudged = mujoco.MjData(recompiled)
    nudged.qpos[:] = composed + NUDGE
    mujoco.mj_step(recompiled, nudged)
    first = float(np.abs(data.qpos - fresh.qpos).max())
    mujoco.mj_step(model, data, nstep=BIT_STEPS - 1)
    return _Differences(
        fields=field_errors(model, recompiled),
        bits=bool(np.array_equal(data.qpos, end)),
        first=first,
        control=float(np.abs(nudged.qpos - fresh.qpos).max()),
        fall=_fall(model, recompiled, composed),
    )


def _fall(model: mujoco.MjModel, recompiled: mujoco.MjModel, start: np.ndarray) -> float:
    """Return the largest difference between both models in a fall without contact.

    Every object is raised to a different height, so that no two touch.

    Raises:
        EngineError: objects touched.
    """
    high = start.copy()
    for k, address in enumerate(model.jnt_qposadr[model.jnt_type == FREE]):
        high[address + 2] += FALL * (k + 1)
    finals = []
    for m in (model, recompiled):
        data = mujoco.MjData(m)
        data.qpos[:] = high
        path = np.empty((FALL_STEPS, m.nq))
        for t in range(FALL_STEPS):
            mujoco.mj_step(m, data)
            path[t] = data.qpos
            if data.ncon:
                raise EngineError("objects raised for a fall without contact touch each other")
        finals.append(path)
    return float(np.abs(finals[0] - finals[1]).max())
