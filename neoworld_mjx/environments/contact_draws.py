"""Draws under the contacts of the estimate: objects do not overlap, and stay over their supports.

The covariance of the estimate ignores contacts. A draw from it is therefore moved to the nearest
layout that satisfies them, in the metric of the covariance: what the photograph leaves open gives
way, and camera and objects still agree about the pixels.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

from ..estimate.rows.contacts import ContactGaps, Gap, SceneGeoms, contacts
from ..estimate.rows.standing import Standing
from ..estimate.unknowns import CAMERA, EACH, Placement, Unknowns
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..physics.photo_view import default_camera
from ..physics.posterior import Draws, pose_factor

STEPS = 4
"""Largest number of times that contacts are linearized: at the scene, and at the last layout."""
REACH_M = 0.04
"""Largest gap of two objects that counts as a contact [m]; a draw may move as far."""
FIT_M = 0.0005
"""Overlap up to which a draw satisfies its contacts [m]."""
SOFT_M = 0.0003
"""Overlap that is as unlikely as a change by one standard deviation [m]."""
WALL_M = 0.05
"""Assumed standard deviation of the place of a wall [m]. The estimate has none. Without it, an
object at a wall would stop all others, since an uncertain camera moves them together."""


@dataclass(frozen=True)
class SceneContacts:
    """The contacts of a scene as a function of normal numbers, as in `Draws.normals`."""

    scene: SceneModel
    sizes: bool = True
    """If False, sizes do not vary."""

    def kept(self, draws: Draws) -> Draws:
        """Return draws whose objects do not overlap, and stay over their supports.

        Each draw moves by the smallest number of standard deviations. Overlaps that objects of
        fixed sizes and places cause remain. Walls give way.
        """
        count = draws.normals.shape[1]
        moved = np.array(
            [
                self.nearest(np.append(normals, np.zeros(2 * len(self.walls))))
                for normals in draws.normals
            ]
        )
        kept = Draws.of(moved[:, :count], draws.spread, self.factor, draws.variation)
        xy = np.array(kept.layouts.xy)
        xy[:, self.walls] = WALL_M * moved[:, count:].reshape(len(moved), -1, 2)
        return kept._replace(layouts=Layout(xy, kept.layouts.yaw, kept.layouts.log_scale))

    @cached_property
    def walls(self) -> list[int]:
        """Indices of the fixed supports on which nothing stands."""
        items = self.scene.spec.objects
        carry = {item.parent for item in items if item.relation != "attached"}
        return [k for k, o in enumerate(items) if o.parent is None and o.name not in carry]

    @cached_property
    def on_wall(self) -> Float[np.ndarray, "wall object"]:
        """1 for each wall, and for the objects that are attached to it; otherwise 0."""
        return np.asarray(self.unknowns.arrangement.ancestors)[:, self.walls].T

    @cached_property
    def unknowns(self) -> Unknowns:
        """Unknowns of the alignment about the scene."""
        spec = self.scene.spec
        return Unknowns.of(spec, spec.camera or default_camera(spec))

    @cached_property
    def colliders(self) -> SceneGeoms:
        """Collision geoms, which move with the unknowns."""
        return SceneGeoms.of(self.scene.spec)

    @cached_property
    def standing(self) -> Standing:
        """Objects that stay over their supports."""
        return Standing.of(self.unknowns, self.colliders)

    @cached_property
    def factor(self) -> Float[np.ndarray, "value normal"]:
        """Matrix of `pose_factor`, whose rows of sizes are zero if these do not vary."""
        factor = pose_factor(self.scene.spec).copy()
        if not self.sizes:
            factor[CAMERA + EACH - 1 :: EACH] = 0.0
        return factor

    @cached_property
    def to_unknowns(self) -> Float[np.ndarray, "u normal"]:
        """Derivatives of the unknowns; those of an object on a wall are along the wall."""
        u = self.unknowns
        rows = np.zeros((u.size, len(self.factor)))
        rows[:CAMERA] = self.factor[:CAMERA]
        for k in u.free.tolist():
            own = self.factor[CAMERA + EACH * k : CAMERA + EACH * (k + 1)].copy()
            if u.in_wall[k].any():
                own[:2] = u.in_wall[k] @ own[:2], np.zeros(len(own[0]))
            rows[u.columns(k)] = own
        return rows

    @cached_property
    def at_scene(self) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n normal"]]:
        """Gaps of the scene itself, and their derivatives."""
        start = np.zeros(self.factor.shape[1] + 2 * len(self.walls))
        (now,) = self.placements(start, near=False)
        return self.linearized(start, now, self.gaps(now))

    def placements(self, values: Float[np.ndarray, " v"], *, near: bool) -> list[Placement]:
        """Return the placement of a draw, or those of `Unknowns.neighbors` near it.

        Args:
            values: normal numbers, followed by the shifts x and y of each wall, in WALL_M.
            near: True for the neighbors.
        """
        u, count = self.unknowns, self.factor.shape[1]
        x = self.to_unknowns @ values[:count]
        moved = np.zeros((len(self.scene.spec.objects), 3))
        moved[:, :2] = WALL_M * (self.on_wall.T @ values[count:].reshape(-1, 2))
        placed = u.neighbors(x) if near else u.place(x[None])
        return [replace(place, pos=place.pos + moved) for place in placed]

    def gaps(self, now: Placement) -> list[Gap]:
        """Return the gaps in the placement of a draw."""
        found = contacts(self.colliders, self.unknowns, now, REACH_M)
        return [*found, *self.standing.insets(self.unknowns, now)]

    def linearized(
        self, values: Float[np.ndarray, " v"], now: Placement, gaps: list[Gap]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n v"]]:
        """Return the gaps of a draw [m], and their derivatives; `now` is the draw's placement."""
        u = self.unknowns
        rows = ContactGaps.of(gaps, u, now, self.placements(values, near=True))
        by_wall = np.zeros((len(gaps), len(self.walls), 2))
        for row, gap in zip(by_wall, gaps, strict=True):
            for point in gap.points:
                row += (
                    WALL_M * point.share * np.outer(self.on_wall[:, point.object], gap.normal[:2])
                )
        by_normals = rows.jacobian[:, : u.size] @ self.to_unknowns
        return rows.gap, np.concatenate(
            [by_normals, by_wall.reshape(len(gaps), 2 * len(self.walls))], axis=1
        )

    def nearest(self, drawn: Float[np.ndarray, " v"]) -> Float[np.ndarray, " v"]:
        """Return the nearest draw with contacts, on a path from the scene, which has them."""
        values, (gap, jacobian) = np.zeros_like(drawn), self.at_scene
        for step in range(STEPS):
            if step:
                (now,) = self.placements(values, near=False)
                gaps = self.gaps(now)
                if min((gap.value for gap in gaps), default=0.0) > -FIT_M:
                    break
                gap, jacobian = self.linearized(values, now, gaps)
            values = drawn + _forced(gap + jacobian @ (drawn - values), jacobian)
        return values


def _forced(
    gap: Float[np.ndarray, " n"], jacobian: Float[np.ndarray, "n normal"]
) -> Float[np.ndarray, " normal"]:
    """Return the smallest step d, such that gap + jacobian @ d is at least zero.

    A gap that remains negative costs its square over SOFT_M squared. The step is jacobian.T @ f
    with forces f of at least zero, which solve the dual problem.
    """
    if not len(gap):
        return np.zeros(jacobian.shape[1])
    dual = np.linalg.cholesky(jacobian @ jacobian.T + SOFT_M**2 * np.eye(len(gap)))
    forces, _ = nnls(dual.T, -np.linalg.solve(dual, gap), maxiter=30 * len(gap))
    return jacobian.T @ forces
