"""The interface of physics engines: Engine, Rollout, RolloutStatus, EarlyStop and Schedule.

This module imports no engine; `simulate` opens engines by name.
"""

import abc
import enum
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from .array_types import AnyArray
from .guidance import Guidance
from .layout import Poses
from .model import SceneModel
from .scene_arrays import SceneArrays


class RolloutStatus(enum.IntEnum):
    """Outcome of a candidate's rollout."""

    OK = 0
    SETTLED = 1
    """Stopped early: at rest, or lingering beyond the stability bounds. The last pose fills the
    remaining records."""
    DRIFTED = 2
    """Stopped early: drifted beyond the cap at which D_drift is clipped."""
    FAILED = 3
    """Not finite, or diverged; the reward is minus infinity."""
    TRUNCATED = 4
    """An engine's capacity dropped contacts, and no other engine could take over."""


class EarlyStop(eqx.Module):
    """Conditions under which a candidate's rollout ends before its time.

    Settled: every speed and acceleration is below its bound, and no speed grows, in `checks`
    consecutive checks after `after`. Angular rates are converted to the speed at the object's edge,
    so that a quivering spoon does not count as moving; the speed of a toppling object grows from
    check to check. A candidate beyond the stability bounds is unstable whatever follows, so it also
    settles if its objects linger: stay within a small part of these bounds for `linger`. With
    `anywhere`, candidates within the bounds settle this way, too. Drifted: an object moved farther
    than `drift` or rotated more than `tilt`. Engines that return states only at records check only
    there.

    Over nine benchmark scenes, the default bounds changed 4 of 1 728 verdicts, all within a factor
    of 2 of a threshold, and took 22 % of the steps.
    """

    after: float = 0.1
    """Earliest time of settling [s]."""
    interval: float = 0.02
    """Time between two checks [s]."""
    checks: int = 3
    speed: float = 0.005
    """[m/s]"""
    acceleration: float = 1.0
    """[m/s^2]"""
    linger: float = 0.06
    """Time within a small part of the stability bounds [s]."""
    anywhere: bool = False
    """True if a candidate that lingers settles even within the stability bounds."""
    distance: float = 0.01
    """Stability bound of translation [m]."""
    angle: float = 0.0872665
    """Stability bound of rotation [rad]."""
    drift: float = 0.1
    """[m]"""
    tilt: float = 0.8726646
    """[rad]"""


class Schedule(NamedTuple):
    """Recorded steps and early stopping of a rollout."""

    records: int
    """Number of recorded states."""
    every: int
    """Steps between two records."""
    early_stop: EarlyStop | None = None
    """None simulates every candidate to the end."""
    guidance: Guidance | None = None
    """Springs that hold free objects at their placed poses; None for a free fall."""


class Rollout(eqx.Module):
    """Motion of every object and joint of every candidate; only movable bases move."""

    time: Float[AnyArray, " time"]
    """Times of the records [s]; the initial state is not recorded."""
    pos: Float[AnyArray, "pop time object 3"]
    """Object origins in the world [m]."""
    quat: Float[AnyArray, "pop time object 4"]
    """Rotations, w first."""
    joint_shift: Float[AnyArray, "pop time joint"]
    """Distance of each joint from its initial position: [rad] for hinges and, as the angle of
    rotation, for balls; [m] for slides. Joints as in `StaticScene.joints`."""
    status: Int[AnyArray, " pop"]
    """RolloutStatus of each candidate."""
    start: Poses
    """Initial poses of the candidates' objects."""
    steps: Int[AnyArray, " pop"]
    """Number of simulated steps."""


def unmoved(scene: SceneArrays, poses: Poses) -> Rollout:
    """Return rollouts of zero duration: initial poses, status OK. Traceable."""
    pop = poses.scale.shape[0]
    return Rollout(
        time=jnp.zeros(1),
        pos=poses.pos[:, None],
        quat=poses.quat[:, None],
        joint_shift=jnp.zeros((pop, 1, scene.joint_object.shape[0])),
        status=jnp.full(pop, int(RolloutStatus.OK), jnp.int32),
        start=poses,
        steps=jnp.zeros(pop, jnp.int32),
    )


@runtime_checkable
class Engine(Protocol):
    """Simulates placed candidates of a scene under gravity."""

    name: str

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
        """Simulate every candidate, initially at rest at its snapped pose.

        Args:
            scene: the compiled scene, which sets the time step.
            poses: initial poses of the candidates' objects, from `SceneModel.place`.
            duration: simulated time [s].
            record_every: time between recorded poses [s].
            early_stop: conditions for stopping candidates early; None simulates all to the end.
            guidance: springs that hold free objects at their placed poses while they fade; None
                for a free fall.

        Returns:
            Poses and a status per candidate; a candidate that fails never raises.

        Raises:
            EngineError: the engine cannot simulate the scene.
        """
        ...


class BatchEngine(abc.ABC):
    """Base of the engines that simulate a population on a schedule."""

    name: str

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
        """Simulate every candidate; see `Engine.rollout`."""
        steps = record_steps(scene.static.mjm.opt.timestep, duration, record_every)
        return self.simulate(scene, poses, Schedule(*steps, early_stop, guidance))

    @abc.abstractmethod
    def simulate(self, scene: SceneModel, poses: Poses, schedule: Schedule) -> Rollout:
        """Simulate every candidate on a schedule; see `Engine.rollout`."""


def unplaceable(poses: Poses, xp: Any = np) -> Any:
    """Return a mask [pop] of candidates with a pose that is not finite or out of range.

    A scale must be between 1e-3 and 1e3, as smaller masses fall below MuJoCo's minimum, and a
    position within 1e6 m. Engines give unplaceable candidates the status FAILED without simulating
    them.

    Args:
        poses: poses of all candidates.
        xp: array module, `jnp` for traced poses.
    """
    # Comparisons with NaN are false, so NaN fails as well.
    sized = (poses.scale > 1e-3) & (poses.scale < 1e3)
    placed = xp.all(xp.abs(poses.pos) < 1e6, axis=-1) & xp.all(xp.isfinite(poses.quat), axis=-1)
    return ~xp.all(sized & placed, axis=1)


def record_steps(timestep: float, duration: float, record_every: float) -> tuple[int, int]:
    """Return the number of records of a rollout, and the steps between two of them."""
    every = max(1, round(record_every / timestep))
    return max(1, round(duration / (every * timestep))), every
