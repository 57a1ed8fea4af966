"""Objects stand: the center of mass of each object is over its support.

An object on a small support, such as a can on a post, would topple from it if its position were off
by the few centimeters that a photograph leaves open. Yet the photograph shows that it stands.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...physics.mjcf import object_of_body
from ...spec import bounds, world_poses
from ...spec.pose import IDENTITY
from ..unknowns import Placement, Unknowns
from .contacts import ContactPoint, Gap, SceneGeoms

LEAST_MASS_KG = 1e-9
"""Mass of an object without mass, such as a fixed support [kg]."""
INSET_DEVIATION_M = 0.0005
"""Standard deviation of a center of mass beyond its inset [m]."""
INSET, MOST_INSET_M = 0.1, 0.01
"""Least distance of a center of mass from the edge of its support, relative to the width of the
support, and at most [m]."""
FAR = 0.25
"""Distance of a composed center of mass outside its support, relative to the width of the object,
above which something else must carry the object, too."""

FAR_PARSED, ELONGATED = 3.0, 2.0
"""The same distance from a parsed place, for an object that is not elongated; least ratio of the
horizontal sides of an elongated object."""


@dataclass(frozen=True)
class Standing:
    """Centers of mass of a scene's objects, and the supports that they stay over."""

    mass: Float[np.ndarray, " object"]
    """[kg]"""
    center: Float[np.ndarray, "object 3"]
    """Composed center of mass of each object in its frame [m]."""
    extent: Float[np.ndarray, "object 2 3"]
    """Low and high corners of each object's bounding box in its frame [m]."""
    supports: tuple[tuple[int, int], ...] = ()
    """Index of each object that stays over its support, and of the support."""

    @classmethod
    def of(cls, unknowns: Unknowns, colliders: SceneGeoms, *, parsed: bool = False) -> "Standing":
        """Return the objects that stay over their supports.

        Args:
            unknowns: the unknowns.
            colliders: the compiled scene, at its composed poses.
            parsed: True if the objects are at their parsed places, which are less accurate than the
                statement of what carries an object that is not elongated.
        """
        scene, model, data = unknowns.scene, colliders.model, colliders.data
        names = [item.name for item in scene.objects]
        owner = object_of_body(model, names)[:, None] == np.arange(len(names))
        mass = np.maximum(model.body_mass @ owner, LEAST_MASS_KG)
        middles = ((model.body_mass[:, None] * data.xipos).T @ owner / mass).T
        centers = [
            at.inverse().apply(middle[None])[0]
            for at, middle in zip(world_poses(scene).values(), middles, strict=True)
        ]
        extent = np.array([bounds(item.spec, item.joint_state) for item in scene.objects])
        standing = cls(mass, np.array(centers), extent)
        return replace(standing, supports=_on_one_support(standing, unknowns, parsed=parsed))

    def insets(self, unknowns: Unknowns, now: Placement) -> Iterator[Gap]:
        """Yield how far centers of mass are inside the edges of their supports in a placement."""
        for k, support in self.supports:
            if k in unknowns.free:
                yield from self.edges(unknowns, now, k, support)

    def edges(self, unknowns: Unknowns, now: Placement, k: int, support: int) -> Iterator[Gap]:
        """Yield how far the center of an object is inside each edge of an upright support.

        The center is that of the object with all that it carries.
        """
        load = np.flatnonzero(unknowns.arrangement.ancestors[:, k])
        shares = self.mass[load] / self.mass[load].sum()
        points = tuple(
            ContactPoint(i, now.world(i, self.center[i][None])[0], share)
            for i, share in zip(load.tolist(), shares.tolist(), strict=True)
        )
        middle = np.sum([point.share * point.position for point in points], axis=0)
        low, high = self.extent[support]
        for axis in range(2):
            inset = min(INSET * float((high - low)[axis]), MOST_INSET_M)
            for edge, sign in ((low, 1.0), (high, -1.0)):
                normal = sign * now.turn[support][:, axis]
                distance = float((middle - now.world(support, edge[None])[0]) @ normal)
                foot = ContactPoint(support, middle - distance * normal, -1.0)
                yield Gap(distance - inset, INSET_DEVIATION_M, normal, (*points, foot))


def _on_one_support(
    standing: Standing, unknowns: Unknowns, *, parsed: bool
) -> tuple[tuple[int, int], ...]:
    """Return the indices of each object that stands on one upright support, and of the support.

    Objects on moving parts, and contents that lean, are omitted. So is an object whose center is
    far outside its support: another object carries it, too, such as a beam on two posts.
    """
    items, found = unknowns.scene.objects, []
    now = unknowns.place(np.zeros((1, unknowns.size)))[0]
    for k, item in enumerate(items):
        upright = np.allclose(item.base_tilt, IDENTITY)
        inside = item.relation == "in" and upright
        if not (item.relation == "on" or inside) or item.parent_link is not None or item.static:
            continue
        support = unknowns.scene.index(item.parent or "")
        if not np.allclose(items[support].base_tilt, IDENTITY):
            continue
        outside = -min(gap.value for gap in standing.edges(unknowns, now, k, support))
        low, high = standing.extent[k]
        shorter, longer = sorted((high - low)[:2].tolist())
        compact = parsed and longer < ELONGATED * shorter
        if outside < (FAR_PARSED if compact else FAR) * longer:
            found.append((k, support))
    return tuple(found)
