"""Array kernels of neoworld_mjx for penetration depths, with a reference implementation in jnp."""

from .blocks import sorted_samples
from .convex_pieces import SPARE, Colliders, PieceGroup
from .penetration_depth import (
    PairDepthTuning,
    pair_depth,
    pair_depth_culled,
    pair_depth_reference,
    pair_gap,
)

__all__ = [
    "SPARE",
    "Colliders",
    "PairDepthTuning",
    "PieceGroup",
    "pair_depth",
    "pair_depth_culled",
    "pair_depth_reference",
    "pair_gap",
    "sorted_samples",
]
