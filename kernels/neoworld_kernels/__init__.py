"""Array operations of neoworld_mjx, one a module: a plain `jnp` reference and faster kernels."""

from .penetration import Group, Solids, pair_depth, pair_depth_reference, signed_distance

__all__ = ["Group", "Solids", "pair_depth", "pair_depth_reference", "signed_distance"]
