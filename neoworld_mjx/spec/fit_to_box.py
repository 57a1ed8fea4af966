"""Isotropic scale that fits an object to its parsed 3D box."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .extent import bounds
from .object import ObjectSpec
from .opening import parsed_state
from .scale import scale, scaled_state
from .tree import PartState, TreeNode


class BoxFit(NamedTuple):
    """Scale that fits an object, with joints as far open as in the photograph, to its 3D box."""

    spec: ObjectSpec
    """The object before scaling."""
    state: dict[str, float]
    """Joint values [rad or m] before scaling; see `parsed_state`."""
    unmatched: list[PartState]
    """Parsed movable parts that match no joint of the object."""
    low: NDArray
    """Lower corner of the object's bounds before scaling [m], shape [3]."""
    high: NDArray
    """Upper corner of the object's bounds before scaling [m], shape [3]."""
    ratio: NDArray
    """Edge lengths of the box divided by the edge lengths of the object's bounds, shape [3]."""
    factor: float
    """Isotropic scale factor."""

    @property
    def bottom_center(self) -> NDArray:
        """Center of the bottom face of the bounds before scaling [m], shape [3]."""
        return np.array([*((self.low[:2] + self.high[:2]) / 2), self.low[2]])

    def scaled(self) -> tuple[ObjectSpec, dict[str, float]]:
        """Return the scaled object and its joint values [rad or m]."""
        return scale(self.spec, self.factor), scaled_state(self.spec, self.state, self.factor)


def fit_to_box(spec: ObjectSpec, node: TreeNode) -> BoxFit:
    """Return the isotropic scale that fits an object to the 3D box of its node.

    The factor is the geometric mean of the ratios of the three edges, that is, the least-squares
    fit of the logarithms.
    """
    state, unmatched = parsed_state(spec, node)
    low, high = bounds(spec, state)
    ratio = np.array(node.box3d.size) / (high - low)
    factor = float(np.exp(np.mean(np.log(ratio))))
    return BoxFit(spec, state, unmatched, low, high, ratio, factor)
