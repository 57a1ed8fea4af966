"""The vocabulary of rollouts: the Engine protocol, Rollout, RolloutStatus and EarlyStop.

No engine is imported here, nor by what this module imports; `simulate` opens engines by name.
"""

import enum
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from .array_types import AnyArray
from .layout import Poses
from .model import SceneModel
from .scene_arrays import SceneArrays


class RolloutStatus(enum.IntEnum):
    """How a candidate's rollout ended."""

    OK = 0
    SETTLED = 1
    """Stopped early at rest, or as it lingers past the bounds of stability; its last pose counts
    for the rest of the time."""
    DRIFTED = 2
    """Stopped early because it had drifted past the cap, where D_drift is clipped anyway."""
    FAILED = 3
    """Not a number, or diverged; its reward is minus infinity."""
    TRUNCATED = 4
    """Contacts were dropped by an engine's cap and no other engine could take over."""


class EarlyStop(eqx.Module):
    """When a candidate's rollout may end before its time.

    Settled: every speed and acceleration below the bounds, and no speed growing, in `checks`
    consecutive checks, not before `after`; rates of turning count by what they mean at the object's
    edge, so that a spoon that quivers is not taken for one that moves, and what begins to topple
    grows faster from check to check. Also settled is a candidate that is past the bounds of
    stability, so that its verdict is known, and whose objects then linger within a small part of
    these bounds; with `anywhere` a candidate that lingers is settled, wherever that is. Drifted: an
    object moved further than `drift` or turned more than `tilt`. Engines that hand states over only
    at records check only there.

    With these bounds 4 verdicts of 1 728 changed over nine scenes of `bench`, all near a bound, at
    22 % of the steps.
    """

    after: float = 0.1
    """[s]"""
    interval: float = 0.02
    """Time between two checks [s]."""
    checks: int = 3
    speed: float = 0.005
    """[m/s]"""
    acceleration: float = 1.0
    """[m/s^2]"""
    linger: float = 0.06
    """[s]"""
    anywhere: bool = False
    distance: float = 0.01
    """Bound of stability [m]."""
    angle: float = 0.0872665
    """Bound of stability [rad]."""
    drift: float = 0.1
    """[m]"""
    tilt: float = 0.8726646
    """[rad]"""


class Rollout(eqx.Module):
    """Motion of every object and joint of every candidate; movable bases move, others do not."""

    time: Float[AnyArray, " time"]
    """Times of the records [s], without the start."""
    pos: Float[AnyArray, "pop time object 3"]
    """Object origins in the world [m]."""
    quat: Float[AnyArray, "pop time object 4"]
    """Rotations, w first."""
    joint_shift: Float[AnyArray, "pop time joint"]
    """Distance of each joint from its position at the start: [rad] for hinges and, as the angle of
    rotation, for balls; [m] for slides. Joints as in `StaticScene.joints`."""
    status: Int[AnyArray, " pop"]
    """RolloutStatus of each candidate."""
    start: Poses
    """Where the candidates' objects were placed."""
    steps: Int[AnyArray, " pop"]
    """Steps that were simulated."""


def unmoved(scene: SceneArrays, poses: Poses) -> Rollout:
    """Return rollouts of no duration: candidates as they were placed, status OK. Traceable."""
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
    """Rolls placed candidates of a scene out under gravity."""

    name: str

    def rollout(
        self,
        scene: SceneModel,
        poses: Poses,
        *,
        duration: float = 1.0,
        record_every: float = 0.1,
        early_stop: EarlyStop | None = None,
    ) -> Rollout:
        """Simulate every candidate from rest at its snapped pose.

        Args:
            scene: the compiled scene; its time step is used.
            poses: where the candidates' objects are placed, by `SceneModel.place`.
            duration: simulated time [s].
            record_every: time between recorded poses [s].
            early_stop: rules for stopping candidates early; None simulates all of them to the end.

        Returns:
            Poses and a status per candidate; a candidate that fails never raises.
        """
        ...


def unplaceable(poses: Poses, xp: Any = np) -> Any:
    """Tell which candidates no engine should try: [pop], true where a pose is not finite or absurd.

    Absurd is a scale below 1e-3 or above 1e3, where masses meet MuJoCo's smallest, or a place
    farther than 1e6 m. Engines give such a candidate the status FAILED without simulating it.

    Args:
        poses: of all candidates.
        xp: `jnp` for traced poses.
    """
    # Comparisons with NaN are false, so it fails without a test of its own.
    sized = (poses.scale > 1e-3) & (poses.scale < 1e3)
    placed = xp.all(xp.abs(poses.pos) < 1e6, axis=-1) & xp.all(xp.isfinite(poses.quat), axis=-1)
    return ~xp.all(sized & placed, axis=1)


def record_steps(timestep: float, duration: float, record_every: float) -> tuple[int, int]:
    """Split a rollout into (number of records, steps between them)."""
    every = max(1, round(record_every / timestep))
    return max(1, round(duration / (every * timestep))), every
