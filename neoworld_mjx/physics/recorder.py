"""Recording of rollouts: states, statuses and early stopping of candidates."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from ..spec.pose import angle_between
from .engine import Rollout, RolloutStatus, Schedule, unplaceable
from .guidance import INTERVAL_S
from .layout import Poses
from .model import BALL, FREE, SLIDE, StaticScene

DIVERGED = 1e10
"""Absolute value of a coordinate above which a candidate has diverged, as in MuJoCo (mjMAXVAL)."""
SIMULATED_FIELDS = ("pos", "quat", "joint_shift", "status", "steps")
"""Fields of a rollout that a simulation computes."""
LINGER_SHARE = 0.15
"""Fraction of the stability bounds within which a lingering object stays."""


class Recorder:
    """States, statuses and steps of candidates [pop] that an engine simulates in segments."""

    def __init__(
        self, static: StaticScene, start: Poses, schedule: Schedule, failed: NDArray | None = None
    ) -> None:
        """Start with all candidates active, except candidates in the mask `failed` [pop]."""
        self.static, self.start = static, start
        records, self.every, self.early_stop, self.guidance = schedule
        pop = start.scale.shape[0]
        precision = np.asarray(start.pos).dtype
        self.qpos = np.zeros((pop, records, static.mjm.nq), precision)
        """Recorded coordinates, in the precision of the poses."""
        self.last = np.full(pop, -1, np.int32)
        """Index of each candidate's last record."""
        self.status = np.full(pop, int(RolloutStatus.OK), np.int32)
        self.steps = np.zeros(pop, np.int32)
        self.active = np.arange(pop)
        """Candidates that are still simulated."""
        self._checks_at_rest = np.zeros(pop, np.int32)
        self._speed = np.full(pop, np.inf)
        """Largest speed at the last check [m/s]."""
        owner, address = _free_bases(static)
        self._base = address[:, None] + np.arange(7)
        initial = np.asarray(start.pos, float)[:, owner], np.asarray(start.quat, float)[:, owner]
        self._start = np.concatenate(initial, axis=-1)
        self._invalid = np.zeros(pop, bool)
        """Candidates with a record beyond the stability bounds."""
        self._anchor = self._start.copy()
        """Poses [pop, free object, 7] about which a candidate's objects linger."""
        self._since = np.zeros(pop, np.int32)
        """Step at which a candidate's objects reached these poses."""
        if failed is not None:
            self.drop(failed, RolloutStatus.FAILED)

    def segments(self) -> list[int]:
        """Return the steps between two records, split at early-stop checks and force updates."""
        intervals = [] if self.early_stop is None else [self.early_stop.interval]
        intervals += [] if self.guidance is None else [INTERVAL_S]
        if not intervals:
            return [self.every]
        interval = min(intervals) / float(self.static.mjm.opt.timestep)
        count = max(1, min(self.every, round(self.every / interval)))
        return np.diff(np.arange(count + 1) * self.every // count).tolist()

    def drop(self, stopped: NDArray, status: RolloutStatus) -> None:
        """Deactivate the candidates in a mask [active], and set their status."""
        self.status[self.active[stopped]] = int(status)
        self.active = self.active[~stopped]

    def record(
        self,
        time: int,
        qpos: NDArray,
        qvel: NDArray | None,
        qacc: NDArray | None,
        steps: int | None = None,
    ) -> NDArray:
        """Record the active candidates' states after a segment, and stop candidates early.

        Args:
            time: index of the record. A later segment of the same record overwrites it.
            qpos: coordinates [active, nq].
            qvel: velocities [active, nv]; not needed without early stopping.
            qacc: accelerations [active, nv]; not needed without early stopping.
            steps: number of steps of the segment; if None, all steps between two records.

        Returns:
            A mask [active] of the candidates that remain active.
        """
        # Comparisons with NaN are false.
        finite: Any = (np.abs(qpos) < DIVERGED).all(axis=1)
        self.drop(~finite, RolloutStatus.FAILED)
        rows = self.active
        self.qpos[rows, time] = qpos[finite]
        self.last[rows] = time
        self.steps[rows] += self.every if steps is None else steps
        if self.early_stop is None or qvel is None or qacc is None or not len(rows):
            return finite
        running = finite.copy()
        running[finite] = self._stop(qpos[finite], qvel[finite], qacc[finite])
        return running

    def _stop(self, qpos: NDArray, qvel: NDArray, qacc: NDArray) -> NDArray:
        """Stop candidates early, and return a mask [active] of candidates that remain active."""
        early_stop, rows = self.early_stop, self.active
        assert early_stop is not None
        length = self.static.characteristic_length
        speed, acceleration = (
            (np.abs(rate) * length).max(axis=1, initial=0.0) for rate in (qvel, qacc)
        )
        rest = (speed < early_stop.speed) & (acceleration < early_stop.acceleration)
        rest &= speed <= self._speed[rows]
        self._speed[rows] = speed
        self._checks_at_rest[rows] = np.where(rest, self._checks_at_rest[rows] + 1, 0)
        timestep = float(self.static.mjm.opt.timestep)
        now = self.steps[rows] * timestep
        settled = (self._checks_at_rest[rows] >= early_stop.checks) & (now >= early_stop.after)
        base = qpos[:, self._base]
        motion = _Motion.between(self._start[rows], base)
        drifted = motion.beyond(early_stop.drift, early_stop.tilt)
        unstable = motion.beyond(early_stop.distance, early_stop.angle)
        left_anchor = _Motion.between(self._anchor[rows], base).beyond(
            LINGER_SHARE * early_stop.distance, LINGER_SHARE * early_stop.angle
        )
        self._anchor[rows[left_anchor]] = base[left_anchor]
        self._since[rows[left_anchor]] = self.steps[rows[left_anchor]]
        lingers = (self.steps[rows] - self._since[rows]) * timestep >= early_stop.linger - 1e-9
        settled |= lingers & (
            unstable | self._invalid[rows] | (early_stop.anywhere & (now >= early_stop.after))
        )
        self._invalid[rows] |= unstable & (self.steps[rows] % self.every == 0)
        self.status[rows[settled]] = int(RolloutStatus.SETTLED)
        self.status[rows[drifted]] = int(RolloutStatus.DRIFTED)
        running = ~(settled | drifted)
        self.active = rows[running]
        return running

    def rollout(self) -> Rollout:
        """Return the rollout on the host. A candidate's last state fills its remaining records."""
        pop, records, _ = self.qpos.shape
        time = np.minimum(np.arange(records), np.maximum(self.last, 0)[:, None])
        states = read_states(self.static, self.start, self.qpos[np.arange(pop)[:, None], time])
        start = jax.tree.map(np.asarray, self.start)
        unrecorded = self.last < 0
        pos, quat, joint_shift = states
        pos[unrecorded] = start.pos[:, None][unrecorded]
        quat[unrecorded] = start.quat[:, None][unrecorded]
        joint_shift[unrecorded] = 0.0
        return Rollout(
            time=record_times(self.static, records, self.every),
            pos=pos,
            quat=quat,
            joint_shift=joint_shift,
            status=self.status,
            start=start,
            steps=self.steps,
        )


class _Motion(NamedTuple):
    """Motion of free objects between two states, computed without square roots and arc cosines."""

    squared: NDArray
    """Squared distances [m^2], shape [candidate, object]."""
    cosine: NDArray
    """Cosines of half the angles."""

    @classmethod
    def between(cls, before: NDArray, after: NDArray) -> "_Motion":
        """Compare poses [candidate, object, 7]."""
        shift = after[..., :3] - before[..., :3]
        squared = np.einsum("cok,cok->co", shift, shift)
        return cls(squared, np.abs(np.einsum("cok,cok->co", after[..., 3:], before[..., 3:])))

    def beyond(self, distance: float, angle: float) -> NDArray:
        """Return a mask of candidates in which an object moved or rotated beyond a bound."""
        far = self.squared > distance**2
        return (far | (self.cosine < np.cos(min(angle, np.pi) / 2))).any(axis=1)


def record_times(static: StaticScene, records: int, every: int) -> NDArray:
    """Return the times of the records [s], shape [time]."""
    times = np.arange(1, records + 1) * every * static.mjm.opt.timestep
    return times.astype(np.float32)


def read_states(
    static: StaticScene, start: Poses, qpos: NDArray
) -> tuple[NDArray, NDArray, NDArray]:
    """Extract object poses and joint shifts from recorded coordinates. Static objects do not move.

    Returns:
        `pos`, `quat` and `joint_shift` of a `Rollout`, in the precision of the poses.
    """
    pop, time, _ = qpos.shape
    objects = start.scale.shape[1]
    owner, address = _free_bases(static)
    poses = []
    for initial, first, width in ((start.pos, 0, 3), (start.quat, 3, 4)):
        values = np.array(np.broadcast_to(initial[:, None], (pop, time, objects, width)))
        values[:, :, owner] = qpos[:, :, address[:, None] + np.arange(first, first + width)]
        poses.append(values)
    shifts = [_joint_shift(static, k, start, qpos) for k in range(len(static.joints))]
    shift = np.stack(shifts, axis=-1) if shifts else np.zeros((pop, time, 0), qpos.dtype)
    return poses[0], poses[1], shift


def _joint_shift(static: StaticScene, k: int, poses: Poses, qpos: NDArray) -> NDArray:
    """Return the distance of joint k from its initial position [m or rad], shape [pop, time]."""
    m, joint = static.mjm, static.joints[k]
    address = int(m.jnt_qposadr[joint])
    if m.jnt_type[joint] == BALL:
        start = static.start[address : address + 4].astype(qpos.dtype)
        return angle_between(start, qpos[:, :, address : address + 4])
    start = np.full((len(qpos), 1), static.start[address], qpos.dtype)
    if poses.variation is not None:
        start += np.asarray(poses.variation.opening)[:, k, None]
    if m.jnt_type[joint] == SLIDE:
        start *= np.asarray(poses.scale)[:, static.joint_object[k], None]
    return np.abs(qpos[:, :, address] - start)


def _free_bases(static: StaticScene) -> tuple[NDArray, NDArray]:
    """Return the object of each free joint, and the address of its first coordinate."""
    free = static.mjm.jnt_type == FREE
    return static.jnt_object[free], static.mjm.jnt_qposadr[free]


def simulate_in_chunks(
    static: StaticScene,
    poses: Poses,
    size: int,
    schedule: Schedule,
    run: Callable[[Poses], Rollout],
) -> Rollout:
    """Roll out the placeable candidates in chunks. All other candidates fail at no cost.

    Returns:
        The rollout of all candidates, on the host.
    """
    bad = unplaceable(poses)
    rows = np.flatnonzero(~bad)
    chunks = [rows[first : first + size] for first in range(0, len(rows), size)]
    if len(chunks) == 1 and not bad.any():
        return run(poses)
    whole = Recorder(static, poses, schedule, np.ones(len(bad), bool)).rollout()
    for chunk in chunks:
        part = run(poses[chunk])
        for name in SIMULATED_FIELDS:
            getattr(whole, name)[chunk] = np.asarray(getattr(part, name))
    return whole
