"""Validity of a scene: comparison of each measure with its bound.

These checks are made once, stored in run.json, and printed everywhere by `SceneCheck.phrase`.
"""

import math
from typing import Any

from ..config import RefineOptions
from ..errors import RunError
from ..quantities import format_quantity
from ..spec import SceneSpec, Spec
from .stability import SceneMeasure, scene_measure

SETTLED_AWAY = "settled_away"
"""Name of the check that no object settled away from the pose at which it was placed."""


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
        where = self.where.replace("|", " and ") or "scene"
        more = f" (and {len(self.failing) - 1} more)" if len(self.failing) > 1 else ""
        value, bound = (format_quantity(v, self.unit) for v in (self.value, self.threshold))
        return f"{where}{more}: {self.quantity} {value}, at most {bound}"

    def to_json(self) -> dict[str, Any]:
        """Return the check and its phrase as JSON data, in which infinity is null."""
        value = self.value if math.isfinite(self.value) else None
        return self.model_dump(mode="json") | {"value": value, "phrase": self.phrase()}


def measured(scene: SceneSpec, o: RefineOptions, *, sleeps: bool = False) -> SceneMeasure:
    """Measure a scene with the duration, time step and bounds of the options."""
    return scene_measure(
        scene,
        duration=o.check_duration_s,
        timestep=o.check_timestep_s,
        max_depth=o.max_depth_m,
        max_drift=o.max_drift_m,
        max_tilt=o.max_tilt_deg,
        sleeps=sleeps,
    )


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
    rotation. A settled scene is also compared with the poses at which its objects were placed. If
    the simulation diverged, every check of a motion and of the final depth fails.
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


def _largest(values: dict[str, float]) -> float:
    return max(values.values(), default=0.0)
