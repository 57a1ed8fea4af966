"""Book-keeping of a population that is rolled out in segments: what was recorded, who has stopped."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import NDArray

from .engine import EarlyStop, Rollout, RolloutStatus, quiet
from .layout import Poses
from .model import FREE, Host, SceneModel
from .native import drift

DIVERGED = 1e10
"""Coordinates beyond this are a failure, as in MuJoCo (mjMAXVAL)."""


class Progress:
    """Recorded states, statuses and steps of candidates [pop]."""

    def __init__(
        self, host: Host, start: Poses, records: int, every: int, rule: EarlyStop | None
    ) -> None:
        """Start with every candidate running.

        Args:
            host: the scene.
            start: where the candidates stand.
            records: how many times states are recorded.
            every: steps between two records.
            rule: when candidates stop early; None lets all run.
        """
        m = host.mjm
        self.every, self.rule, self.timestep = every, rule, float(m.opt.timestep)
        self.lever = host.lever
        self.start = start
        pop = start.scale.shape[0]
        self.qpos = np.zeros((records, pop, m.nq), np.float32)
        self.last = np.full(pop, -1, np.int32)
        """Index of each candidate's last record."""
        self.status = np.full(pop, int(RolloutStatus.OK), np.int32)
        self.steps = np.zeros(pop, np.int32)
        self.calm = np.zeros(pop, np.int32)
        self.active = np.arange(pop)
        free = np.flatnonzero(m.jnt_type == FREE)
        owner = host.jnt_object[free]
        self.address = m.jnt_qposadr[free][:, None] + np.arange(7)
        if rule is not None:
            self.pos0 = np.asarray(start.pos)[:, owner]
            self.quat0 = np.asarray(start.quat)[:, owner]

    def drop(self, gone: NDArray, status: RolloutStatus) -> None:
        """Take candidates [active], given by a mask, out with a status."""
        self.status[self.active[gone]] = int(status)
        self.active = self.active[~gone]

    def record(
        self, time: int, qpos: NDArray, qvel: NDArray | None, qacc: NDArray | None
    ) -> NDArray:
        """Note the active candidates' states after a segment, and stop those that may stop.

        Args:
            time: index of the record.
            qpos: coordinates [active, nq].
            qvel: velocities [active, nv]; not needed without a rule.
            qacc: accelerations [active, nv]; likewise.

        Returns:
            A mask [active] of the rows that run on.
        """
        # Comparisons with NaN are false.
        sound: Any = (np.abs(qpos) < DIVERGED).all(axis=1)
        rows = self.active[sound]
        if sound.all():
            self.qpos[time, rows] = qpos
        else:
            self.drop(~sound, RolloutStatus.FAILED)
            self.qpos[time, rows] = qpos[sound]
        self.last[rows] = time
        self.steps[rows] += self.every
        if self.rule is None or qvel is None or qacc is None or not len(rows):
            return sound
        on = sound.copy()
        on[sound] = self._going(time, qpos[sound], qvel[sound], qacc[sound])
        return on

    def _going(self, time: int, qpos: NDArray, qvel: NDArray, qacc: NDArray) -> NDArray:
        rule, rows = self.rule, self.active
        assert rule is not None
        still = quiet(rule, self.lever, qvel, qacc)
        self.calm[rows] = np.where(still, self.calm[rows] + 1, 0)
        settled = (self.calm[rows] >= 2) & ((time + 1) * self.every * self.timestep >= rule.after)
        seven = qpos[:, self.address]
        far, turned = drift(seven[..., :3], seven[..., 3:], self.pos0[rows], self.quat0[rows])
        drifted = (far.max(axis=1) > rule.drift) | (turned.max(axis=1) > rule.tilt)
        self.status[rows[settled]] = int(RolloutStatus.SETTLED)
        self.status[rows[drifted]] = int(RolloutStatus.DRIFTED)
        going = ~(settled | drifted)
        self.active = rows[going]
        return going

    def rollout(self, scene: SceneModel) -> Rollout:
        """Return what was recorded; a candidate's last pose stands for the rest of the time."""
        recorded, last = jnp.asarray(self.qpos), jnp.asarray(self.last)
        pos, quat = _poses(scene, self.start, recorded, last)
        return Rollout(
            time=jnp.arange(1, len(self.qpos) + 1) * self.every * self.timestep,
            pos=pos,
            quat=quat,
            status=jnp.asarray(self.status),
            start=self.start,
            steps=jnp.asarray(self.steps),
        )


@eqx.filter_jit
def _poses(
    scene: SceneModel,
    start: Poses,
    qpos: Float[Array, "time pop nq"],
    last: Int[Array, " pop"],
) -> tuple[Float[Array, "pop time object 3"], Float[Array, "pop time object 4"]]:
    time = jnp.minimum(jnp.arange(qpos.shape[0])[None], jnp.maximum(last, 0)[:, None])
    held = jnp.asarray(qpos)[time, jnp.arange(qpos.shape[1])[:, None]]
    pos, quat = object_poses(scene, start, held)
    never = (jnp.asarray(last) < 0)[:, None, None, None]
    return (
        jnp.where(never, start.pos[:, None], pos),
        jnp.where(never, start.quat[:, None], quat),
    )


def object_poses(
    scene: SceneModel, start: Poses, qpos: Float[Array, "pop time nq"]
) -> tuple[Float[Array, "pop time object 3"], Float[Array, "pop time object 4"]]:
    """Read object poses out of recorded coordinates; static objects stay where they are."""
    pop, time, _ = qpos.shape
    count = start.scale.shape[1]
    pos = jnp.broadcast_to(start.pos[:, None], (pop, time, count, 3))
    quat = jnp.broadcast_to(start.quat[:, None], (pop, time, count, 4))
    m = scene.host.mjm
    free = np.flatnonzero(m.jnt_type == FREE)
    if not len(free):
        return pos, quat
    owner, adr = scene.host.jnt_object[free], m.jnt_qposadr[free]
    pos = pos.at[:, :, owner].set(qpos[:, :, adr[:, None] + np.arange(3)])
    return pos, quat.at[:, :, owner].set(qpos[:, :, adr[:, None] + np.arange(3, 7)])
