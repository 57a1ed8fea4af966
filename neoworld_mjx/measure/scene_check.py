"""Validity of a scene: comparison of each measure with its bound, for `check` and `refine`."""

import math

from ..config import RefineOptions
from ..spec import SceneSpec, Spec
from .stability import SceneMeasure, scene_measure


class SceneCheck(Spec):
    """One measure of a scene and its bound."""

    name: str
    value: float
    threshold: float
    passed: bool
    where: str = ""
    """Object, pair or joint that has the value; empty if the scene has none."""

    def phrase(self) -> str:
        """Return one line, such as "max_tilt_deg 12.3 of mug, over 5"."""
        return (
            f"{self.name} {self.value:.3g} of {self.where or 'the scene'}, over {self.threshold:g}"
        )


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


def scene_checks(measure: SceneMeasure, o: RefineOptions) -> tuple[SceneCheck, ...]:
    """Compare every measure with its bound.

    Sliding joints are compared with the bound of translation, and turning joints with the bound of
    rotation. If the simulation diverged, every check except that of the initial depth fails.
    """
    depth, drift, tilt = o.max_depth_m, o.max_drift_m, o.max_tilt_deg
    measures = (
        ("max_depth_m", measure.max_depth_m, depth, measure.depths_m),
        ("settled_depth_m", measure.settled_depth_m, depth, measure.settled_depths_m),
        ("max_drift_m", measure.max_drift_m, drift, measure.drift_m),
        ("max_tilt_deg", measure.max_tilt_deg, tilt, measure.tilt_deg),
        ("max_joint_slide_m", _largest(measure.joint_slide_m), drift, measure.joint_slide_m),
        ("max_joint_turn_deg", _largest(measure.joint_turn_deg), tilt, measure.joint_turn_deg),
    )
    checks = []
    for name, value, threshold, values in measures:
        # A depth may equal its bound, as in S-Pen. A motion may not.
        passed = value <= threshold if "depth" in name else value < threshold
        if measure.diverged and "max_depth" not in name:
            value, passed = math.inf, False
        where = max(values, key=values.__getitem__, default="")
        checks.append(
            SceneCheck(name=name, value=value, threshold=threshold, passed=passed, where=where)
        )
    return tuple(checks)


def passes(measure: SceneMeasure, o: RefineOptions) -> bool:
    """Return whether a scene satisfies every bound."""
    return all(check.passed for check in scene_checks(measure, o))


def _largest(values: dict[str, float]) -> float:
    return max(values.values(), default=0.0)
