"""Isotropic scale of an object that fits it to its parsed 3D box."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .extent import bounds
from .object import ObjectSpec
from .opening import parsed_state
from .scale import scale, scaled_state
from .tree import PartState, TreeNode


class BoxFit(NamedTuple):
    """Scale of an object whose joints are as far open as in the photograph."""

    spec: ObjectSpec
    """The object before scaling."""
    state: dict[str, float]
    """Joint values [rad or m] before scaling; see `parsed_state`."""
    unmatched: list[PartState]
    """Parsed parts that no joint of the object matches."""
    low: NDArray
    """Lower corner of the object's bounds before scaling [3] m."""
    high: NDArray
    """Upper corner [3] m."""
    ratio: NDArray
    """Edge lengths of the box over those of the object [3]."""
    factor: float
    """Isotropic scale factor."""

    @property
    def bottom_center(self) -> NDArray:
        """Center of the bottom face of the bounds before scaling [3] m."""
        return np.array([*((self.low[:2] + self.high[:2]) / 2), self.low[2]])

    def scaled(self) -> tuple[ObjectSpec, dict[str, float]]:
        """Return the scaled object and its joint values [rad or m]."""
        return scale(self.spec, self.factor), scaled_state(self.spec, self.state, self.factor)


def fit_to_box(spec: ObjectSpec, node: TreeNode) -> BoxFit:
    """Return the isotropic scale that fits an object to the 3D box of its node.

    The factor is the geometric mean of the ratios of the three edges, which is the least-squares
    fit in log space.
    """
    state, unmatched = parsed_state(spec, node)
    low, high = bounds(spec, state)
    ratio = np.array(node.box3d.size) / (high - low)
    factor = float(np.exp(np.mean(np.log(ratio))))
    return BoxFit(spec, state, unmatched, low, high, ratio, factor)
