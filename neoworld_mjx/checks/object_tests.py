"""The object tests: all checks of a single object, and the verdict on them.

The static checks run first, then the sweep over the ranges of all joints, then all scenarios in
one batched rollout. An error inside a check is an outcome of its own and never counts as a pass.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np

from ..config import VerifyOptions
from ..spec import ObjectSpec, Quat
from ..spec.pose import IDENTITY
from .allowance import Allowance
from .joint_checks import JointChecks, check_joints
from .motion_checks import check_motion
from .scenarios import list_scenarios
from .simulation import Simulation, Trajectory
from .static_checks import check_statics, without_bad_inertia
from .verdict import Check, ScenarioKind, Verdict

VERSION = "7"
"""Increased when the same object may get another verdict; part of the key of cached results."""


@dataclass(frozen=True)
class ObjectTests:
    """Result of testing one object: the verdict, and measurements for repairs and pictures."""

    spec: ObjectSpec
    verdict: Verdict
    joint_checks: JointChecks
    simulation: Simulation | None
    """The compiled object; None if it cannot be compiled."""
    trajectories: Sequence[Trajectory]
    """Trajectory of each scenario."""


def run_object_tests(
    spec: ObjectSpec,
    options: VerifyOptions | None = None,
    *,
    fixed_base: bool = False,
    tilt: Quat = IDENTITY,
    joint_state: dict[str, float] | None = None,
    allowed: Sequence[Allowance] = (),
    threads: int = 0,
) -> ObjectTests:
    """Test an object by itself on a floor.

    Free fall drops it from small heights and tilts, force perturbation pushes and twists each part,
    every joint is released, coasts and is driven, and the ground tilts until the object slides.

    Args:
        spec: the object.
        options: durations, impulses and thresholds.
        fixed_base: True if its base is fixed; then only the scenarios of its joints are simulated.
        tilt: its resting orientation, for instance that of an object that lies on its side.
        joint_state: positions of its joints while it falls and is pushed [rad or m].
        allowed: overlaps that its program declares.
        threads: threads of the rollout; 0 uses all cores.
    """
    options = options or VerifyOptions()
    checks: list[Check] = []
    joint_checks = JointChecks()
    simulation: Simulation | None = None
    trajectories: list[Trajectory] = []
    with _record_error("static", checks):
        checks += list(check_statics(spec))
    with _record_error("joint_range", checks):
        joint_checks = check_joints(spec, options, allowed)
        checks += joint_checks.checks
    with _record_error("free_fall", checks):
        simulation = Simulation(without_bad_inertia(spec, checks), options, tilt, joint_state)
        scenarios = list_scenarios(
            simulation.groups, simulation.joints, options, fixed_base=fixed_base
        )
        trajectories = simulation.run(scenarios, threads)
        checks += list(check_motion(simulation, trajectories))
    verdict = Verdict(
        object=spec.name,
        passed=not any(check.failed for check in checks),
        mass_kg=float("nan") if simulation is None else simulation.mass,
        battery=VERSION,
        checks=tuple(checks),
    )
    return ObjectTests(spec, verdict, joint_checks, simulation, trajectories)


@contextmanager
def _record_error(scenario: ScenarioKind, checks: list[Check]) -> Iterator[None]:
    """Turn an error of the tests themselves into a check of its own."""
    try:
        yield
    except (ValueError, mujoco.FatalError, np.linalg.LinAlgError) as error:
        hint = str(error)[:300]
        checks.append(Check(scenario=scenario, name="runs", outcome="TOOL_FAILURE", hint=hint))
