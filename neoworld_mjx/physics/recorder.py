"""The recorder that all engines share: states, statuses, and which candidates have stopped."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ..spec.pose import angle_between
from .engine import EarlyStop, Rollout, RolloutStatus
from .layout import Poses
from .model import BALL, FREE, SLIDE, StaticScene

DIVERGED = 1e10
"""Coordinates beyond this are a failure, as in MuJoCo (mjMAXVAL)."""


class Recorder:
    """Recorded states, statuses and steps of candidates [pop] that are rolled out in segments."""

    def __init__(
        self,
        static: StaticScene,
        start: Poses,
        records: int,
        every: int,
        rule: EarlyStop | None,
        failed: NDArray,
    ) -> None:
        """Start with every candidate running but those that have failed already.

        Args:
            static: static data of the scene.
            start: where the candidates' objects are placed.
            records: how many times states are recorded.
            every: steps between two records.
            rule: when candidates stop early; None lets all run.
            failed: mask [pop] of candidates that cannot be placed; see `unplaceable`.
        """
        self.static, self.start, self.every, self.rule = static, start, every, rule
        pop = start.scale.shape[0]
        self.qpos = np.zeros((pop, records, static.mjm.nq), np.float32)
        self.last = np.full(pop, -1, np.int32)
        """Index of each candidate's last record."""
        self.status = np.full(pop, int(RolloutStatus.OK), np.int32)
        self.steps = np.zeros(pop, np.int32)
        self.active = np.arange(pop)
        """Candidates that run on."""
        self._checks_at_rest = np.zeros(pop, np.int32)
        _, owner, address = _free_bases(static)
        self._base = address[:, None] + np.arange(7)
        self._start = np.asarray(start.pos)[:, owner], np.asarray(start.quat)[:, owner]
        self.drop(np.asarray(failed), RolloutStatus.FAILED)

    def drop(self, stopped: NDArray, status: RolloutStatus) -> None:
        """Take candidates [active], given by a mask, out with a status."""
        self.status[self.active[stopped]] = int(status)
        self.active = self.active[~stopped]

    def record(
        self, time: int, qpos: NDArray, qvel: NDArray | None, qacc: NDArray | None
    ) -> NDArray:
        """Record the active candidates' states after a segment, and stop those that may stop.

        Args:
            time: index of the record.
            qpos: coordinates [active, nq].
            qvel: velocities [active, nv]; not needed without a rule.
            qacc: accelerations [active, nv]; likewise.

        Returns:
            A mask [active] of the rows that run on.
        """
        # Comparisons with NaN are false.
        finite: Any = (np.abs(qpos) < DIVERGED).all(axis=1)
        self.drop(~finite, RolloutStatus.FAILED)
        rows = self.active
        self.qpos[rows, time] = qpos[finite]
        self.last[rows] = time
        self.steps[rows] += self.every
        if self.rule is None or qvel is None or qacc is None or not len(rows):
            return finite
        running = finite.copy()
        running[finite] = self._stop(time, qpos[finite], qvel[finite], qacc[finite])
        return running

    def _stop(self, time: int, qpos: NDArray, qvel: NDArray, qacc: NDArray) -> NDArray:
        """Stop candidates by the rule; return a mask [active] of those that run on."""
        rule, rows = self.rule, self.active
        assert rule is not None
        rest = at_rest(rule, self.static.characteristic_length, qvel, qacc)
        self._checks_at_rest[rows] = np.where(rest, self._checks_at_rest[rows] + 1, 0)
        now = (time + 1) * self.every * float(self.static.mjm.opt.timestep)
        settled = (self._checks_at_rest[rows] >= 2) & (now >= rule.after)
        base, (pos, quat) = qpos[:, self._base], self._start
        distance = np.linalg.norm(base[..., :3] - pos[rows], axis=-1)
        angle = angle_between(quat[rows], base[..., 3:])
        drifted = (distance > rule.drift).any(axis=1) | (angle > rule.tilt).any(axis=1)
        self.status[rows[settled]] = int(RolloutStatus.SETTLED)
        self.status[rows[drifted]] = int(RolloutStatus.DRIFTED)
        running = ~(settled | drifted)
        self.active = rows[running]
        return running

    def rollout(self) -> Rollout:
        """Return what was recorded; a candidate's last state counts for the rest of the time."""
        pop, records, _ = self.qpos.shape
        time = np.minimum(np.arange(records), np.maximum(self.last, 0)[:, None])
        states = read_states(self.static, self.start, self.qpos[np.arange(pop)[:, None], time], np)
        start = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), self.start)
        unrecorded = self.last < 0
        for values, at in zip(states, (start.pos[:, None], start.quat[:, None], 0.0), strict=True):
            values[unrecorded] = at[unrecorded] if isinstance(at, np.ndarray) else at
        pos, quat, joint_shift = (jnp.asarray(values) for values in states)
        return Rollout(
            time=record_times(self.static, records, self.every),
            pos=pos,
            quat=quat,
            joint_shift=joint_shift,
            status=jnp.asarray(self.status),
            start=jax.tree.map(jnp.asarray, start),
            steps=jnp.asarray(self.steps),
        )


def record_times(static: StaticScene, records: int, every: int) -> Any:
    """Return the times of the records [s], shape [time]."""
    return jnp.asarray(np.arange(1, records + 1) * every * static.mjm.opt.timestep, jnp.float32)


def at_rest(rule: EarlyStop, length: NDArray, qvel: NDArray, qacc: NDArray) -> NDArray:
    """Tell which candidates [pop] are below the bounds of `rule` at this moment.

    Args:
        rule: the bounds.
        length: `StaticScene.characteristic_length` [nv].
        qvel: velocities [pop, nv].
        qacc: accelerations [pop, nv].
    """
    slow = (np.abs(qvel) * length).max(axis=1, initial=0.0) < rule.speed
    return slow & ((np.abs(qacc) * length).max(axis=1, initial=0.0) < rule.acceleration)


def read_states(static: StaticScene, start: Poses, qpos: Any, xp: Any) -> tuple[Any, Any, Any]:
    """Read object poses and joint shifts out of recorded coordinates; static objects stay.

    Args:
        static: static data of the scene.
        start: where the candidates' objects are placed.
        qpos: coordinates [pop, time, nq].
        xp: `numpy`, or `jnp` for traced coordinates.

    Returns:
        `pos`, `quat` and `joint_shift` of a `Rollout`, in single precision.
    """
    pop, time, _ = qpos.shape
    objects = start.scale.shape[1]
    _, owner, address = _free_bases(static)
    whole = []
    for at, first, width in ((start.pos, 0, 3), (start.quat, 3, 4)):
        values = xp.broadcast_to(at[:, None], (pop, time, objects, width))
        moved = qpos[:, :, address[:, None] + np.arange(first, first + width)]
        if xp is np:
            values = values.astype(np.float32)
            values[:, :, owner] = moved
        elif len(owner):
            values = values.at[:, :, owner].set(moved)
        whole.append(values)
    shifts = [_joint_shift(static, k, start.scale, qpos, xp) for k in range(len(static.joints))]
    shift = xp.stack(shifts, axis=-1) if shifts else xp.zeros((pop, time, 0))
    return whole[0], whole[1], shift.astype(np.float32)


def _joint_shift(static: StaticScene, k: int, scale: Any, qpos: Any, xp: Any) -> Any:
    """Return how far joint k has moved from its start, [pop, time], [m] or [rad]."""
    m, joint = static.mjm, static.joints[k]
    address = int(m.jnt_qposadr[joint])
    if m.jnt_type[joint] == BALL:
        start = static.start[address : address + 4].astype(np.float32)
        return angle_between(xp.asarray(start), qpos[:, :, address : address + 4], xp)
    start = np.float32(static.start[address])
    if m.jnt_type[joint] == SLIDE:
        start = (start * scale[:, static.joint_object[k]])[:, None]
    return xp.abs(qpos[:, :, address] - start)


def _free_bases(static: StaticScene) -> tuple[NDArray, NDArray, NDArray]:
    """Return the free joints, the object of each, and the address of its first coordinate."""
    free = np.flatnonzero(static.mjm.jnt_type == FREE)
    return free, static.jnt_object[free], static.mjm.jnt_qposadr[free]


def joined(parts: Sequence[Rollout], pop: int) -> Rollout:
    """Join rollouts of consecutive candidates; of the last what goes beyond `pop` is filling."""
    if len(parts) == 1 and parts[0].status.shape[0] == pop:
        return parts[0]
    whole = jax.tree.map(lambda *rows: jnp.concatenate(rows)[:pop], *parts)
    return eqx.tree_at(lambda r: r.time, whole, parts[0].time)
