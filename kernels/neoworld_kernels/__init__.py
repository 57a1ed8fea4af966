"""Array operations of neoworld_mjx, one a module: a plain `jnp` reference and faster kernels."""

from .penetration import PairDepthTuning, pair_depth, pair_depth_culled, pair_depth_reference
from .solids import Group, Solids, signed_distance

__all__ = [
    "Group",
    "PairDepthTuning",
    "Solids",
    "pair_depth",
    "pair_depth_culled",
    "pair_depth_reference",
    "signed_distance",
]
