"""Validity of a scene: S-Pen and S-Stab, the physical measures of the paper's scene table.

C MuJoCo computes the measures. They are compared with their bounds once; the checks are stored in
run.json, and printed everywhere by `SceneCheck.phrase`.
"""

import math
from typing import Any

import numpy as np
from jaxtyping import Bool
from pydantic import Field

from ..config import RefineOptions
from ..errors import CROWDED, EngineError, RunError
from ..physics.engine import Engine, RolloutStatus
from ..physics.layout import Poses
from ..physics.model import CompiledScene, compile_for_simulation
from ..physics.rest import Rested, rest
from ..quantities import format_quantity
from ..spec import SceneSpec, Spec


class SceneMeasure(Spec):
    """Penetration and stability of a scene."""

    objects: int
    movable: int
    """Number of objects with a free base. If there are none, stability is undefined."""
    s_pen: int | None
    """1 if two objects penetrate deeper than the bound in the composed pose, else 0."""
    max_depth_m: float
    """Largest penetration depth of two objects in the composed pose."""
    settled_depth_m: float
    """Largest penetration depth at the end of the simulation, when contacts bear weight."""
    depths_m: dict[str, float] = Field(default_factory=dict)
    """Penetration depth of each penetrating pair "a|b" in the composed pose."""
    settled_depths_m: dict[str, float] = Field(default_factory=dict)
    """Penetration depth of each penetrating pair "a|b" at the end of the simulation."""
    s_stab: bool | None
    """True if every object stayed within the bounds at all times, and none is held; None without
    movable objects."""
    max_drift_m: float
    max_tilt_deg: float
    drift_m: dict[str, float] = Field(default_factory=dict)
    tilt_deg: dict[str, float] = Field(default_factory=dict)
    joint_slide_m: dict[str, float] = Field(default_factory=dict)
    """Largest displacement of each sliding joint "object-joint"."""
    joint_turn_deg: dict[str, float] = Field(default_factory=dict)
    """Largest rotation of each turning joint "object-joint"."""
    duration_s: float
    diverged: bool = False
    held: tuple[str, ...] = ()
    """Names of the objects that were fixed in their places, since they do not rest there."""
    displacement: dict[str, float] | None = None
    """Displacement of each movable object by settling from the pose at which it was placed,
    relative to its limit (`physics.placed.settling_displacement`), or, if that is more, from its
    estimate (`search.finishing.deviations_from`); None for a scene that was measured as it is."""


def measured(scene: SceneSpec, o: RefineOptions | None = None) -> SceneMeasure:
    """Measure penetration in the composed pose, and drift in a simulation that starts from it.

    The simulation has no drag. The poses after every step are compared with the composed pose.
    Stepping releases the GIL, so several scenes may be measured in threads.

    Args:
        scene: the scene.
        o: duration and bounds of the final check.

    Raises:
        EngineError: the scene has more contacts than MuJoCo's memory holds.
    """
    o, world = o or RefineOptions(), compile_for_simulation(scene)
    rested = rest(world, world.poses(), hold=None, free_s=o.check_duration_s)
    return measures_of(world, rested, o)[0]


def measures_of(world: CompiledScene, rested: Rested, o: RefineOptions) -> list[SceneMeasure]:
    """Return the measures of candidates that fell freely, without displacements by settling.

    Raises:
        EngineError: a candidate has more contacts than MuJoCo's memory holds.
    """
    if (rested.status == int(RolloutStatus.TRUNCATED)).any():
        raise EngineError(f"the scene has more contacts than MuJoCo's memory holds: {CROWDED}")
    static = world.static
    movable = np.flatnonzero(static.movable)
    names = [static.names[n] for n in movable]
    slides, joints = static.joint_slides, np.array(static.joint_names, object)
    by_name = lambda keys, values: dict(zip(keys, values.tolist(), strict=True))
    pairs = lambda depths: {f"{a}|{b}": depth for (a, b), depth in depths.items()}
    held = tuple(item.name for item in world.spec.objects if item.held)
    measures = []
    for k, status in enumerate(rested.status):
        drift = rested.drift[k, movable]
        tilt, joint = np.degrees(rested.tilt[k, movable]), rested.joint_motion[k]
        diverged = status != int(RolloutStatus.OK) or not np.isfinite(drift).all()
        before = pairs(rested.depths[k])
        after = {} if diverged else pairs(rested.end_depths[k])
        stable = not (diverged or held)
        stable &= bool((drift < o.max_drift_m).all() and (tilt < o.max_tilt_deg).all())
        measures.append(
            SceneMeasure(
                objects=len(static.names),
                movable=len(names),
                s_pen=int(_largest(before) > o.max_depth_m),
                max_depth_m=_largest(before),
                settled_depth_m=_largest(after),
                depths_m=before,
                settled_depths_m=after,
                s_stab=stable if names or held else None,
                max_drift_m=math.inf if diverged else float(drift.max(initial=0.0)),
                max_tilt_deg=math.inf if diverged else float(tilt.max(initial=0.0)),
                drift_m=by_name(names, drift),
                tilt_deg=by_name(names, tilt),
                joint_slide_m=by_name(joints[slides], joint[slides]),
                joint_turn_deg=by_name(joints[~slides], np.degrees(joint[~slides])),
                duration_s=o.check_duration_s,
                diverged=diverged,
                held=held,
            )
        )
    return measures


def rest_and_measure(
    world: CompiledScene,
    start: Poses,
    o: RefineOptions,
    *,
    settles: bool = True,
    placed: Poses | None = None,
    engine: Engine | None = None,
    stop_early: bool = False,
) -> tuple[Poses, list[SceneMeasure]]:
    """Settle candidates, let them fall, and measure them; see `physics.rest.rest`.

    Args:
        world: the compiled scene.
        start: poses from which the candidates settle.
        o: options of settling and of the final check.
        settles: if False, the candidates fall from `start`.
        placed: poses to which displacements by settling are relative; by default `start`.
        engine: engine of the simulation, as for `rest`; by default `native`.
        stop_early: if True, candidates at rest are not simulated to the end.

    Returns:
        The settled poses, and a measure of each candidate with its displacement by settling.

    Raises:
        EngineError: the engine cannot run, or a candidate has more contacts than MuJoCo's memory
            holds.
    """
    rested = rest(
        world,
        start,
        hold=o.settle if settles else None,
        free_s=o.check_duration_s,
        engine=engine,
        placed=placed,
        stop_early=stop_early,
    )
    measures = measures_of(world, rested, o)
    movable = np.flatnonzero(world.static.movable)
    moved = [{world.names[n]: float(row[n]) for n in movable} for row in rested.moved]
    return rested.poses, [
        measure.model_copy(update={"displacement": by_object})
        for measure, by_object in zip(measures, moved, strict=True)
    ]


SETTLED_AWAY = "settled_away"
"""Name of the check that no object settled away from the pose at which it was placed."""


HELD = "held"
"""Name of the check that no object is held; it is made if one is."""


class SceneCheck(Spec):
    """One measure of a scene and its bound."""

    name: str
    quantity: str
    """Measured quantity, in words."""
    value: float
    """Largest value of any object, pair or joint."""
    threshold: float
    unit: str
    passed: bool
    where: str = ""
    """Object, pair "a|b" or joint "object-joint" that has the value; empty if the scene has
    none."""
    failing: tuple[str, ...] = ()
    """All objects, pairs or joints with values beyond the threshold, the worst first."""

    def phrase(self) -> str:
        """Return one line, such as "mug: tilt 12.3 degrees, at most 5.0 degrees"."""
        if self.name == HELD:
            return f"{', '.join(self.failing)}: {self.quantity}"
        where = self.where.replace("|", " and ") or "scene"
        more = f" (and {len(self.failing) - 1} more)" if len(self.failing) > 1 else ""
        value, bound = (format_quantity(v, self.unit) for v in (self.value, self.threshold))
        return f"{where}{more}: {self.quantity} {value}, at most {bound}"

    def to_json(self) -> dict[str, Any]:
        """Return the check and its phrase as JSON data, in which infinity is null."""
        value = self.value if math.isfinite(self.value) else None
        return self.model_dump(mode="json") | {"value": value, "phrase": self.phrase()}


def with_displacement(measure: SceneMeasure, stored: object) -> SceneMeasure:
    """Return a measure with the displacement by settling that a run stored in its metrics.

    Args:
        measure: measures of the run's scene.
        stored: displacement by object, or None.

    Raises:
        RunError: `stored` has another type.
    """
    if stored is None:
        return measure
    if not isinstance(stored, dict) or not all(isinstance(v, int | float) for v in stored.values()):
        raise RunError("run.json is damaged: metrics.displacement must be numbers by object")
    return measure.model_copy(update={"displacement": stored})


def scene_checks(measure: SceneMeasure, o: RefineOptions) -> tuple[SceneCheck, ...]:
    """Compare every measure with its bound.

    Sliding joints are compared with the bound of translation, and turning joints with the bound of
    rotation. A settled scene is also compared with the poses at which its objects were placed. A
    scene with held objects fails. If the simulation diverged, every check of a motion and of the
    final depth fails.
    """
    depth, drift, tilt = o.max_depth_m, o.max_drift_m, o.max_tilt_deg
    m, slide, turn = measure, measure.joint_slide_m, measure.joint_turn_deg
    rows = [
        ("max_depth_m", "penetration", m.max_depth_m, depth, "m", m.depths_m),
        ("settled_depth_m", "penetration at rest", m.settled_depth_m, depth, "m",
         m.settled_depths_m),
        ("max_drift_m", "drift", m.max_drift_m, drift, "m", m.drift_m),
        ("max_tilt_deg", "tilt", m.max_tilt_deg, tilt, "deg", m.tilt_deg),
        ("max_joint_slide_m", "slide of the joint", _largest(slide), drift, "m", slide),
        ("max_joint_turn_deg", "turn of the joint", _largest(turn), tilt, "deg", turn),
    ]  # fmt: skip
    if (moved := m.displacement) is not None:
        rows.append(
            (
                SETTLED_AWAY,
                "settled away from its place by",
                _largest(moved),
                1.0,
                "of the limit",
                moved,
            )
        )
    if m.held:
        names = dict.fromkeys(m.held, 1.0)
        rows.append(
            (HELD, "fixed in place, since it does not rest there", len(names), 0.0, "", names)
        )
    checks = []
    for name, quantity, value, threshold, unit, values in rows:
        # A depth or displacement may equal its bound, as in S-Pen. A motion may not.
        inclusive = "depth" in name or name == SETTLED_AWAY
        if m.diverged and name not in ("max_depth_m", SETTLED_AWAY):
            value = math.inf
        within = lambda v, most=threshold, inclusive=inclusive: (
            v < most or (inclusive and v == most)
        )
        worst_first = sorted(values, key=values.__getitem__, reverse=True)
        checks.append(
            SceneCheck(
                name=name,
                quantity=quantity,
                value=value,
                threshold=threshold,
                unit=unit,
                passed=within(value),
                where=worst_first[0] if worst_first else "",
                failing=tuple(key for key in worst_first if not within(values[key])),
            )
        )
    return tuple(checks)


def passes(measure: SceneMeasure, o: RefineOptions) -> bool:
    """Return True if a scene satisfies every bound."""
    return all(check.passed for check in scene_checks(measure, o))


def resting(
    scene: SceneSpec, measure: SceneMeasure, o: RefineOptions
) -> Bool[np.ndarray, " object"]:
    """Return a mask of the objects that satisfy every bound.

    Such an object penetrates no other object, is stable with its joints, and did not settle away.
    """
    failing = {name for check in scene_checks(measure, o) for name in check.failing}
    faulty = {part.split("-", 1)[0] for name in failing for part in name.split("|")}
    return np.array(
        [
            item.name not in faulty and (item.static or not measure.diverged)
            for item in scene.objects
        ]
    )


def _largest(values: dict[str, float]) -> float:
    return max(values.values(), default=0.0)
