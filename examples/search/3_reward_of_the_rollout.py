"""A reward that needs the rollout: objects should settle slowly."""

import jax.numpy as jnp

import neoworld_mjx as nw
from neoworld_mjx.config import RefineOptions
from neoworld_mjx.sweeps import case


def calm(scene, layouts, rollout):
    """Return minus the largest mean speed between two records, over all objects [m/s]."""
    pos = jnp.concatenate([rollout.start.pos[:, None], rollout.pos], axis=1)
    time = jnp.concatenate([jnp.zeros(1), rollout.time])
    step = jnp.diff(pos, axis=1) * scene.movable[:, None]
    speed = jnp.sqrt(jnp.sum(step**2, axis=-1) + 1e-12) / jnp.diff(time)[:, None]
    return -jnp.max(speed, axis=(1, 2))


options = RefineOptions.model_validate(
    {
        "cem": {"population": 16, "iterations": 2},
        "rollout": {"engine": "native", "duration_s": 0.5, "early_stop": False},
    }
)
refined = nw.refine(case("crowded:2").scene, options, terms=[nw.Term("calm", calm, weight=2.0)])
print(f"{refined.rollouts} rollouts, passed: {refined.passed}")
print(f"peak speed of the delivered scene: {-refined.delivered['calm']:.4f} m/s")
