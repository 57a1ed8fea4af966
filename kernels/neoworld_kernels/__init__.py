"""Array kernels of neoworld_mjx in jnp: penetration depths, and first hits of camera rays."""

from .convex_pieces import SPARE, Colliders, PieceGroup, pair_depth_reference, pair_gap
from .penetration import pair_depth, pair_depth_culled, sorted_samples

__all__ = [
    "SPARE",
    "Colliders",
    "PieceGroup",
    "pair_depth",
    "pair_depth_culled",
    "pair_depth_reference",
    "pair_gap",
    "sorted_samples",
]
