"""The recorder that all engines share: states, statuses, and which candidates have stopped."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from ..spec.pose import angle_between
from .engine import EarlyStop, Rollout, RolloutStatus, unplaceable
from .layout import Poses
from .model import BALL, FREE, SLIDE, StaticScene

DIVERGED = 1e10
"""Coordinates beyond this are a failure, as in MuJoCo (mjMAXVAL)."""
SIMULATED = ("pos", "quat", "joint_shift", "status", "steps")
"""What of a rollout a simulation makes."""
LINGER_SHARE = 0.15
"""Share of the bounds of stability within which an object is said to linger."""


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
        self._speed = np.full(pop, np.inf)
        """Largest speed at the last check [m/s]."""
        _, owner, address = _free_bases(static)
        self._base = address[:, None] + np.arange(7)
        places = np.asarray(start.pos, float)[:, owner], np.asarray(start.quat, float)[:, owner]
        self._start = np.concatenate(places, axis=-1)
        self._invalid = np.zeros(pop, bool)
        """Candidates that a record shows past the bounds of stability."""
        self._anchor = self._start.copy()
        """Poses [pop, free object, 7] that a candidate's objects linger about."""
        self._since = np.zeros(pop, np.int32)
        """Step at which they came there."""
        self.drop(np.asarray(failed), RolloutStatus.FAILED)

    def segments(self) -> list[int]:
        """Split the steps between two records at the checks that the rule asks for."""
        if self.rule is None:
            return [self.every]
        interval = self.rule.interval / float(self.static.mjm.opt.timestep)
        count = max(1, min(self.every, round(self.every / interval)))
        return np.diff(np.arange(count + 1) * self.every // count).tolist()

    def drop(self, stopped: NDArray, status: RolloutStatus) -> None:
        """Take candidates [active], given by a mask, out with a status."""
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
        """Record the active candidates' states after a segment, and stop those that may stop.

        Args:
            time: index of the record; a later segment of the same record writes over it.
            qpos: coordinates [active, nq].
            qvel: velocities [active, nv]; not needed without a rule.
            qacc: accelerations [active, nv]; likewise.
            steps: of the segment; None counts all between two records.

        Returns:
            A mask [active] of the rows that run on.
        """
        # Comparisons with NaN are false.
        finite: Any = (np.abs(qpos) < DIVERGED).all(axis=1)
        self.drop(~finite, RolloutStatus.FAILED)
        rows = self.active
        self.qpos[rows, time] = qpos[finite]
        self.last[rows] = time
        self.steps[rows] += self.every if steps is None else steps
        if self.rule is None or qvel is None or qacc is None or not len(rows):
            return finite
        running = finite.copy()
        running[finite] = self._stop(qpos[finite], qvel[finite], qacc[finite])
        return running

    def _stop(self, qpos: NDArray, qvel: NDArray, qacc: NDArray) -> NDArray:
        """Stop candidates by the rule; return a mask [active] of those that run on."""
        rule, rows = self.rule, self.active
        assert rule is not None
        length = self.static.characteristic_length
        speed, acceleration = (
            (np.abs(rate) * length).max(axis=1, initial=0.0) for rate in (qvel, qacc)
        )
        rest = (speed < rule.speed) & (acceleration < rule.acceleration)
        rest &= speed <= self._speed[rows]
        self._speed[rows] = speed
        self._checks_at_rest[rows] = np.where(rest, self._checks_at_rest[rows] + 1, 0)
        now = self.steps[rows] * float(self.static.mjm.opt.timestep)
        settled = (self._checks_at_rest[rows] >= rule.checks) & (now >= rule.after)
        base = qpos[:, self._base]
        moved = _Motion.between(self._start[rows], base)
        drifted = moved.beyond(rule.drift, rule.tilt)
        past = moved.beyond(rule.distance, rule.angle)
        settled |= self._lingers(base) & (past | self._invalid[rows] | rule.anywhere)
        recorded = self.steps[rows] % self.every == 0
        self._invalid[rows] |= past & recorded
        self.status[rows[settled]] = int(RolloutStatus.SETTLED)
        self.status[rows[drifted]] = int(RolloutStatus.DRIFTED)
        running = ~(settled | drifted)
        self.active = rows[running]
        return running

    def _lingers(self, base: NDArray) -> NDArray:
        """Tell which active candidates have stayed about one place for the rule's time."""
        rule, rows = self.rule, self.active
        assert rule is not None
        moved = _Motion.between(self._anchor[rows], base)
        left = moved.beyond(LINGER_SHARE * rule.distance, LINGER_SHARE * rule.angle)
        self._anchor[rows[left]] = base[left]
        self._since[rows[left]] = self.steps[rows[left]]
        time = (self.steps[rows] - self._since[rows]) * float(self.static.mjm.opt.timestep)
        return time >= rule.linger - 1e-9

    def rollout(self) -> Rollout:
        """Return what was recorded, on the host; a candidate's last state counts for the rest."""
        pop, records, _ = self.qpos.shape
        time = np.minimum(np.arange(records), np.maximum(self.last, 0)[:, None])
        states = read_states(self.static, self.start, self.qpos[np.arange(pop)[:, None], time], np)
        start = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), self.start)
        unrecorded = self.last < 0
        for values, at in zip(states, (start.pos[:, None], start.quat[:, None], 0.0), strict=True):
            values[unrecorded] = at[unrecorded] if isinstance(at, np.ndarray) else at
        pos, quat, joint_shift = states
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
    """How far free objects are from some places; compared without roots and arcs."""

    squared: NDArray
    """Squares of the distances [m^2], shape [candidate, object]."""
    cosine: NDArray
    """Cosines of half the angles."""

    @classmethod
    def between(cls, places: NDArray, base: NDArray) -> "_Motion":
        """Compare poses [candidate, object, 7]."""
        product = lambda a, b: np.einsum("cok,cok->co", a, b)
        shift = base[..., :3] - places[..., :3]
        return cls(product(shift, shift), np.abs(product(base[..., 3:], places[..., 3:])))

    def beyond(self, distance: float, angle: float) -> NDArray:
        """Tell candidates in which an object moved further than `distance` or turned more."""
        far = self.squared > distance**2
        return (far | (self.cosine < np.cos(min(angle, np.pi) / 2))).any(axis=1)


def record_times(static: StaticScene, records: int, every: int) -> NDArray:
    """Return the times of the records [s], shape [time]."""
    times = np.arange(1, records + 1) * every * static.mjm.opt.timestep
    return times.astype(np.float32)


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


def in_chunks(
    static: StaticScene,
    poses: Poses,
    size: int,
    records: int,
    every: int,
    run: Callable[[Poses], Rollout],
) -> Rollout:
    """Roll out the candidates that can be placed, some at a time; the others fail where they are.

    Populations of many runs are filled up with candidates that cannot be placed, so that they have
    few shapes; here these cost nothing.

    Args:
        static: static data of the scene.
        poses: of all candidates, on the host.
        size: most candidates at once.
        records: how many states are recorded.
        every: steps between two records.
        run: rolls some candidates out.

    Returns:
        The rollout of all, on the host.
    """
    bad = unplaceable(poses)
    rows = np.flatnonzero(~bad)
    parts = [rows[first : first + size] for first in range(0, len(rows), size)]
    if len(parts) == 1 and not bad.any():
        return run(poses)
    whole = Recorder(static, poses, records, every, None, np.ones(len(bad), bool)).rollout()
    for own in parts:
        part = run(poses[own])
        for name in SIMULATED:
            getattr(whole, name)[own] = np.asarray(getattr(part, name))
    return whole
