"""The object tests: all checks of a single object, and the verdict.

The static checks run first, then the sweep over the ranges of all joints, and then all scenarios in
one batched rollout. If a check raises an error, the outcome is TOOL_FAILURE, which does not count
as a pass.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np

from ..config import VerifyOptions
from ..spec import ObjectSpec, Quat
from ..spec.pose import IDENTITY
from .joint_checks import SWEEP_S, JointChecks, check_joints
from .motion_checks import check_motion
from .scenarios import affordable, list_scenarios
from .signals import Allowance
from .simulation import TIMESTEP_S, Simulation, Trajectory
from .static_checks import OutOfTime, check_statics, without_bad_inertia
from .verdict import BUDGET, Check, ScenarioKind, Verdict, skipped

VERSION = "9"
"""Version of the object tests, which is part of the key of cached results.

It is increased when a change of the tests can change the verdict on an object.
"""


@dataclass(frozen=True)
class ObjectTests:
    """Results of testing one object: the verdict, and measurements for repairs and pictures."""

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
    allowed: Sequence[Allowance] = (),
    threads: int = 0,
) -> ObjectTests:
    """Test an object by itself on a level floor.

    The object falls from a small height, upright and tilted. Each part is pushed. Each
    joint is released, coasts, and is driven over its range.

    Args:
        spec: the object.
        options: durations, impulses and thresholds.
        fixed_base: if True, the base is fixed, and only the scenarios of joints are simulated.
        tilt: orientation in which the object rests, for example lying on its side.
        allowed: overlaps that the object's program declares.
        threads: number of threads of the rollout; if 0, use all cores.
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
        simulation = Simulation(without_bad_inertia(spec, checks), options, tilt)
        scenarios = list_scenarios(
            simulation.groups, simulation.joints, options, fixed_base=fixed_base
        )
        steps = round(options.duration_s / TIMESTEP_S)
        scenarios, left_out = affordable(scenarios, steps, simulation.model.nv)
        if left_out:
            reason = (
                f"{len(left_out)} parts and joints are neither pushed nor moved, because the "
                f"object has too many for one test: {', '.join(left_out[:5])}"
            )
            checks.append(skipped("force_perturbation", BUDGET, reason))
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
    """Convert an error that the tests raise into a check with the outcome TOOL_FAILURE."""
    try:
        yield
    except OutOfTime:
        hint = f"it takes over {SWEEP_S:g} s of processor time; use fewer shapes and joints"
        checks.append(Check(scenario=scenario, name="runs", outcome="TOOL_FAILURE", hint=hint))
    except (ValueError, mujoco.FatalError, np.linalg.LinAlgError) as error:
        hint = str(error)[:300]
        checks.append(Check(scenario=scenario, name="runs", outcome="TOOL_FAILURE", hint=hint))
