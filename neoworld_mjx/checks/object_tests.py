"""The battery: all checks of a single object, as one verdict.

Static checks come first, then the sweep over all joints' ranges, then all scenarios of the object
in one batched rollout. An error of a check is an outcome of its own, never a pass.
"""

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from ..config import VerifyOptions
from ..spec import ObjectSpec, Quat
from ..spec.pose import IDENTITY
from .allowance import Allowance
from .joint_checks import JointChecks, check_joints
from .motion_checks import checks_of
from .scenarios import list_scenarios
from .simulation import Simulation, Trajectory
from .static_checks import statics, without_bad_inertia
from .verdict import Check, ScenarioKind, Verdict

VERSION = "6"
"""Increased when the same object may get another verdict; part of the key of cached results."""


class Battery:
    """One run of the battery: its verdict, and its measurements for repairs and pictures.

    An object is tried by itself on a floor. Free fall drops it from small heights and tilts, force
    perturbation pushes and twists each part, every joint is released, coasts and is driven, and the
    ground is tilted until the object slides.

    Args:
        spec: the object.
        options: durations, impulses and thresholds.
        fixed_base: whether its base is fixed; then the scenarios are those of its joints.
        tilt: its resting orientation, such as that of an object that lies.
        joint_state: positions of its joints while it falls and is pushed [rad or m].
        allowed: overlaps that its program declares.
        threads: threads of the rollout; 0 takes all cores.
    """

    def __init__(
        self,
        spec: ObjectSpec,
        options: VerifyOptions | None = None,
        *,
        fixed_base: bool = False,
        tilt: Quat = IDENTITY,
        joint_state: dict[str, float] | None = None,
        allowed: Sequence[Allowance] = (),
        threads: int = 0,
    ) -> None:
        self.spec, self.options = spec, options or VerifyOptions()
        self.simulation: Simulation | None = None
        self.trajectories: list[Trajectory] = []
        self.joint_checks = JointChecks()
        checks: list[Check] = []

        def static() -> list[Check]:
            return statics(spec, self.options)

        def sweep() -> list[Check]:
            self.joint_checks = check_joints(spec, self.options, allowed)
            return self.joint_checks.checks

        def moving() -> list[Check]:
            valid = without_bad_inertia(spec, checks)
            self.simulation = Simulation(valid, self.options, tilt, joint_state)
            runs = list_scenarios(
                self.simulation.groups, self.simulation.joints, self.options, fixed_base=fixed_base
            )
            self.trajectories = self.simulation.run(runs, threads)
            return checks_of(self.simulation, self.trajectories)

        steps: list[tuple[ScenarioKind, Callable[[], list[Check]]]] = [
            ("static", static),
            ("joint_range", sweep),
            ("free_fall", moving),
        ]
        for name, run in steps:
            try:
                checks += run()
            except (ValueError, mujoco.FatalError, np.linalg.LinAlgError) as error:
                # An error of a check says nothing about the object, so it is no pass.
                checks.append(
                    Check(scenario=name, name="runs", outcome="TOOL_FAILURE", hint=str(error)[:300])
                )
        bad = any(check.outcome in ("FAIL", "TOOL_FAILURE") for check in checks)
        self.verdict = Verdict(
            object=spec.name,
            passed=not bad,
            mass_kg=float("nan") if self.simulation is None else self.simulation.mass,
            battery=VERSION,
            checks=tuple(checks),
        )
