"""Rewards that need the rollout: objects should settle slowly, and 3 cm apart."""

import jax.numpy as jnp

import neoworld_mjx as nw
from neoworld_mjx.config import RefineOptions
from neoworld_mjx.sweeps import case


def calm(scene, layouts, rollout):
    """Return minus the largest mean speed between two records, over all objects [m/s]."""
    speed, _ = nw.rewards.speeds(rollout)
    return -jnp.max(speed, axis=(1, 2))


def apart(scene, layouts, rollout):
    """Return 1 where the two objects keep 3 cm between them, less where they are closer."""
    gap = nw.rewards.gaps(scene, layouts, rollout)[:, 1, 2]
    return jnp.clip(gap / 0.03, -1.0, 1.0)


options = RefineOptions.model_validate(
    {
        "cem": {"population": 16, "iterations": 2},
        "rollout": {"engine": "native", "duration_s": 0.5, "early_stop": False},
    }
)
refined = nw.refine(
    case("crowded:2").scene,
    options,
    terms=[nw.Term("calm", calm, weight=2.0), nw.Term("apart", apart, weight=1.0)],
)
print(f"{refined.rollouts} rollouts, passed: {refined.passed}")
print(f"apart by {30 * refined.scores['apart']:.0f} mm or more")
print(f"peak speed of the winner: {-refined.scores['calm']:.4f} m/s")
