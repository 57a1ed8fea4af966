"""Book-keeping of a population that is rolled out in segments: what was recorded, who has stopped."""

import jax.numpy as jnp
import numpy as np

from .engine import EarlyStop, Rollout, RolloutStatus, quiet
from .layout import Poses
from .model import FREE, Host
from .native import drift

DIVERGED = 1e10
"""Coordinates beyond this are a failure, as in MuJoCo (mjMAXVAL)."""


class Progress:
    """Recorded poses, statuses and steps of candidates [pop]; rows are updated as they advance."""

    def __init__(
        self, host: Host, start: Poses, records: int, every: int, rule: EarlyStop | None
    ) -> None:
        """Start with every candidate running.

        Args:
            host: the scene.
            start: where the candidates stand, NumPy or JAX leaves.
            records: how many times poses are recorded.
            every: steps between two records.
            rule: when candidates stop early; None lets all run.
        """
        m = host.mjm
        self.every, self.rule, self.timestep = every, rule, float(m.opt.timestep)
        self.start = start
        self.lever = host.lever
        self.pos0, self.quat0 = (
            np.asarray(start.pos, np.float32),
            np.asarray(start.quat, np.float32),
        )
        pop, objects = self.pos0.shape[:2]
        self.pos = np.broadcast_to(self.pos0[:, None], (pop, records, objects, 3)).copy()
        self.quat = np.broadcast_to(self.quat0[:, None], (pop, records, objects, 4)).copy()
        self.status = np.full(pop, int(RolloutStatus.OK), np.int32)
        self.steps = np.zeros(pop, np.int32)
        self.calm = np.zeros(pop, np.int32)
        self.active = np.arange(pop)
        free = np.flatnonzero(m.jnt_type == FREE)
        self.owner = host.jnt_object[free]
        self.address = m.jnt_qposadr[free][:, None] + np.arange(7)

    def drop(self, gone: np.ndarray, status: RolloutStatus) -> None:
        """Take candidates [active], given by a mask, out with a status."""
        self.status[self.active[gone]] = int(status)
        self.active = self.active[~gone]

    def record(self, time: int, qpos: np.ndarray, qvel: np.ndarray, qacc: np.ndarray) -> np.ndarray:
        """Note the active candidates' states after a segment, and stop those that may stop.

        Args:
            time: index of the record.
            qpos: coordinates [active, nq].
            qvel: velocities [active, nv].
            qacc: accelerations [active, nv].

        Returns:
            A mask [active] of the rows that run on.
        """
        on = np.asarray(np.isfinite(qpos) & (np.abs(qpos) < DIVERGED)).all(axis=1)
        before = self.active
        self.drop(np.logical_not(on), RolloutStatus.FAILED)
        rows = self.active
        self.steps[rows] += self.every
        if len(self.owner):
            seven = qpos[on][:, self.address][:, :, None]
            # Until more is known this pose stands for the rest of the time.
            self.pos[rows[:, None], time:, self.owner] = seven[..., :3]
            self.quat[rows[:, None], time:, self.owner] = seven[..., 3:]
        if self.rule is not None and len(rows):
            self._stop(time, qvel[on], qacc[on])
        return np.isin(before, self.active, assume_unique=True)

    def _stop(self, time: int, qvel: np.ndarray, qacc: np.ndarray) -> None:
        rule, rows = self.rule, self.active
        assert rule is not None
        still = quiet(rule, self.lever, qvel, qacc)
        self.calm[rows] = np.where(still, self.calm[rows] + 1, 0)
        settled = (self.calm[rows] >= 2) & ((time + 1) * self.every * self.timestep >= rule.after)
        far, turned = drift(
            self.pos[rows, time], self.quat[rows, time], self.pos0[rows], self.quat0[rows]
        )
        drifted = (far.max(axis=1) > rule.drift) | (turned.max(axis=1) > rule.tilt)
        self.status[rows[settled]] = int(RolloutStatus.SETTLED)
        self.status[rows[drifted]] = int(RolloutStatus.DRIFTED)
        self.active = rows[~(settled | drifted)]

    def rollout(self, start: Poses) -> Rollout:
        """Return what was recorded as a Rollout that starts at `start`."""
        records = self.pos.shape[1]
        return Rollout(
            time=jnp.arange(1, records + 1) * self.every * self.timestep,
            pos=jnp.asarray(self.pos),
            quat=jnp.asarray(self.quat),
            status=jnp.asarray(self.status),
            start=start,
            steps=jnp.asarray(self.steps),
        )
