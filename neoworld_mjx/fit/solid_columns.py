"""Vertical columns through an object's collision geometry, for overlaps and support heights."""

import numpy as np
from jaxtyping import Float

from ..measure.boxes import footprint, upright
from ..physics.support import posed_pieces, vertical_intersections
from ..spec import ObjectSpec, SceneObject, TreeNode
from ..spec.fit_to_box import fit_to_box
from ..spec.pose import from_yaw, pose, rotate

SAMPLES = 15
"""Number of columns along each side of a footprint."""


class SolidColumns:
    """Vertical columns [m] in the world through an object that is scaled to its parsed box.

    Attributes:
        xy: positions of the columns that intersect the object [m].
        bottom: lowest height of the object in each column [m].
        top: highest height of the object in each column [m].
    """

    def __init__(self, node: TreeNode, spec: ObjectSpec) -> None:
        fit = fit_to_box(spec, node)
        middle = fit.factor * fit.bottom_center
        scaled, state = fit.scaled()
        item = SceneObject(name=node.name, spec=scaled, base_tilt=node.base_tilt, joint_state=state)
        x, y, z = node.box3d.position
        to_world = pose((x, y, 0.0), from_yaw(node.box3d.yaw)).then(
            pose(-rotate(node.base_tilt, middle))
        )
        self._pieces = [(piece, to_world.then(local)) for piece, local in posed_pieces(item)]
        self.articulated = any(joint.type != "fixed" for joint in spec.joints)
        self._lift = 0.0
        corners = footprint(upright(node))
        sides = np.linspace(corners.min(axis=0), corners.max(axis=0), SAMPLES).T
        xy = np.stack(np.meshgrid(*sides, indexing="ij"), -1).reshape(-1, 2)
        lows, highs = self.spans(xy)
        bottom, top = lows.min(axis=0), highs.max(axis=0)
        intersects = np.isfinite(bottom)
        if intersects.any():
            self._lift = float(z - bottom.min())
        self.xy = xy[intersects]
        self.bottom, self.top = bottom[intersects] + self._lift, top[intersects] + self._lift

    def spans(
        self, xy: Float[np.ndarray, "k 2"]
    ) -> tuple[Float[np.ndarray, "p k"], Float[np.ndarray, "p k"]]:
        """Return the lowest and the highest height [m] of each convex piece in vertical columns.

        The result is (inf, -inf) for a piece that does not intersect the column.
        """
        columns = [
            vertical_intersections(piece, piece_pose, xy) for piece, piece_pose in self._pieces
        ]
        return (
            np.array([low for low, _ in columns]) + self._lift,
            np.array([high for _, high in columns]) + self._lift,
        )

    def depth(self, other: "SolidColumns", shift: Float[np.ndarray, " 3"]) -> float:
        """Return the largest vertical overlap [m] with another object after a shift of this one."""
        lows, highs = other.spans(self.xy + shift[:2])
        top, bottom = self.top + shift[2], self.bottom + shift[2]
        return float(np.max(np.minimum(highs, top) - np.maximum(lows, bottom), initial=-np.inf))
