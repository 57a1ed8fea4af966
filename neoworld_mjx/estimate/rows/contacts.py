"""Contacts between objects in a placement. The alignment treats them as inequalities.

The contour of an object hardly determines its distance along the view. Without contacts, neighbors
would slide into each other. Settling would then push them apart, away from their positions in the
photograph.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int

from ...physics.colliders import geom_distance, object_of_geom, start_state
from ...spec import SceneSpec, world_poses
from ...spec.pose import matrix
from ..unknowns import STEP, Placement, Unknowns

REACH_M = 0.01
"""Largest gap between two geoms that counts as a contact [m]."""
STEEPEST = 0.8
"""Largest absolute vertical component of a contact's unit normal. Steeper contacts are ignored,
because supports determine heights."""
MOST_CONTACTS = 6
"""Largest number of contacts between two objects; the contacts with the smallest gaps are used."""
LEAST_LINE_M = 1e-7
"""Distance between the nearest points of two geoms below which their normal is undefined [m]."""
OVERLAP_M = 0.002
"""Standard deviation of the overlap of two objects [m]."""
DEEP_M = 0.005
"""Overlap at which the precision of a contact is halved [m]. Deeper overlaps are probably due to
wrong shapes."""


class ContactPoint(NamedTuple):
    """A point of an object, whose motion changes a gap by share * normal @ motion."""

    object: int
    position: Float[np.ndarray, " 3"]
    """In the world [m]."""
    share: float


class Gap(NamedTuple):
    """Signed distance along a normal, which must be at least zero."""

    value: float
    """[m]"""
    deviation: float
    """Standard deviation of a negative value [m]."""
    normal: Float[np.ndarray, " 3"]
    points: tuple[ContactPoint, ...]
    resizes: bool = False
    """True if the sizes of the objects may give way, too."""


class ContactGaps(NamedTuple):
    """Linearized gaps; gap + jacobian @ change must be at least zero."""

    gap: Float[np.ndarray, " n"]
    """Signed distance [m]; negative is penetration depth."""
    jacobian: Float[np.ndarray, "n v"]
    """Derivatives of the gaps with respect to all unknowns and stretches; those with respect to
    stretches, and to sizes that do not give way, are zero."""
    precision: Float[np.ndarray, " n"]
    """Precision of a negative gap [1/m^2]."""

    @classmethod
    def of(
        cls,
        gaps: Sequence[Gap],
        unknowns: Unknowns,
        now: Placement,
        neighbors: Sequence[Placement],
    ) -> "ContactGaps":
        """Linearize gaps in a placement.

        Args:
            gaps: the gaps.
            unknowns: the unknowns.
            now: the placement.
            neighbors: the placements of `Unknowns.neighbors`.
        """
        jacobian = np.zeros((len(gaps), unknowns.size_with_stretches))
        for row, gap in zip(jacobian, gaps, strict=True):
            for k, position, share in gap.points:
                local = now.local(k, position[None])
                for u in unknowns.columns_of(k):
                    if gap.resizes or not unknowns.is_size(u):
                        moved = neighbors[u].world(k, local) - now.world(k, local)
                        row[u] += share * (moved[0] @ gap.normal) / STEP
        precision = [1 / gap.deviation**2 for gap in gaps]
        return cls(np.array([gap.value for gap in gaps]), jacobian, np.array(precision))


@dataclass(frozen=True)
class SceneGeoms:
    """Collision geoms of a scene in the frames of their objects.

    `place` modifies the model and its data.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    geom: Int[np.ndarray, " geom"]
    """Index of each collision geom in the model."""
    owner: Int[np.ndarray, " geom"]
    """Index of each geom's object."""
    pos: Float[np.ndarray, "geom 3"]
    """Composed position of each geom in the object's frame [m]."""
    mat: Float[np.ndarray, "geom 3 3"]
    """Composed rotation of each geom in the object's frame."""
    size: Float[np.ndarray, "geom 3"]
    """Composed size of each geom, as in MuJoCo's `geom_size` [m]."""
    radius: Float[np.ndarray, " geom"]
    """Radius of each geom's bounding sphere [m]; 0 for planes."""
    vertex: Float[np.ndarray, "vertex 3"]
    """Vertices of all meshes at the composed size [m]."""
    vertex_owner: Int[np.ndarray, " vertex"]
    """Index of each vertex's object; -1 for none."""

    @classmethod
    def of(cls, scene: SceneSpec) -> "SceneGeoms":
        """Compile a composed scene, once for all placements."""
        model, data = start_state(scene)
        owner = object_of_geom(scene, model)
        collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        geom = np.flatnonzero((owner >= 0) & collides)
        owner = owner[geom]
        poses = list(world_poses(scene).values())
        origin = np.array([pose.pos for pose in poses])[owner]
        turn = np.array([matrix(pose.quat) for pose in poses])[owner]
        vertex_owner = np.full(model.nmeshvert, -1)
        for mesh, k in zip(model.geom_dataid[geom].tolist(), owner.tolist(), strict=True):
            if mesh >= 0:
                first = int(model.mesh_vertadr[mesh])
                vertex_owner[first : first + int(model.mesh_vertnum[mesh])] = k
        return cls(
            model,
            data,
            geom,
            owner,
            np.einsum("nji,nj->ni", turn, data.geom_xpos[geom] - origin),
            np.einsum("nji,njk->nik", turn, data.geom_xmat[geom].reshape(-1, 3, 3)),
            model.geom_size[geom].copy(),
            model.geom_rbound[geom].copy(),
            model.mesh_vert.copy(),
            vertex_owner,
        )

    def place(self, place: Placement) -> None:
        """Move and scale the geoms with their objects to a placement."""
        m, d, k = self.model, self.data, self.owner
        scale, turn = place.scale[k], place.turn[k]
        offset = np.einsum("nij,nj->ni", turn, scale[:, None] * self.pos)
        d.geom_xpos[self.geom] = place.pos[k] + offset
        d.geom_xmat[self.geom] = (turn @ self.mat).reshape(-1, 9)
        m.geom_size[self.geom] = scale[:, None] * self.size
        m.geom_rbound[self.geom] = scale * self.radius
        m.mesh_vert[:] = self.vertex * np.append(place.scale, 1.0)[self.vertex_owner, None]

    def near(
        self, counts: Bool[np.ndarray, "object object"], reach: float
    ) -> Int[np.ndarray, "pair 2"]:
        """Return the pairs of geoms whose bounding spheres are less than `reach` [m] apart.

        Pairs are indices into `geom`.

        Args:
            counts: mask of the pairs of objects whose contacts are used.
            reach: distance [m].
        """
        m, pos = self.model, self.data.geom_xpos[self.geom]
        # The bounding radius of a plane is zero.
        radius = np.where(self.radius > 0, m.geom_rbound[self.geom], np.inf)
        first, second = np.nonzero(np.triu(counts[self.owner[:, None], self.owner], 1))
        apart = np.linalg.norm(pos[first] - pos[second], axis=1)
        rows = apart - radius[first] - radius[second] < reach
        return np.stack([first[rows], second[rows]], axis=1)


def contacts(
    colliders: SceneGeoms, unknowns: Unknowns, now: Placement, reach: float = REACH_M
) -> Iterator[Gap]:
    """Yield the smallest gaps between each pair of objects in a placement.

    Gaps with steep normals are omitted, see `STEEPEST`.

    Args:
        colliders: the scene's collision geoms.
        unknowns: the unknowns.
        now: the placement.
        reach: largest gap between two geoms that counts as a contact [m].
    """
    colliders.place(now)
    found: dict[tuple[int, int], list[Gap]] = {}
    for a, b in colliders.near(_counts(unknowns), reach).tolist():
        ends = np.zeros(6)
        geoms = int(colliders.geom[a]), int(colliders.geom[b])
        gap = geom_distance(colliders.model, colliders.data, *geoms, reach, ends)
        line = ends[3:] - ends[:3]
        length = float(np.linalg.norm(line))
        if gap >= reach or length <= LEAST_LINE_M or abs(line[2]) >= STEEPEST * length:
            continue
        pair = int(colliders.owner[a]), int(colliders.owner[b])
        points = tuple(
            ContactPoint(k, end, share)
            for k, end, share in zip(pair, ends.reshape(2, 3), (-1.0, 1.0), strict=True)
        )
        # The two end points are swapped for overlapping geoms.
        normal, deviation = (
            line / length * np.sign(gap),
            OVERLAP_M * math.hypot(1, min(gap, 0.0) / DEEP_M),
        )
        found.setdefault(pair, []).append(Gap(gap, deviation, normal, points, resizes=True))
    for gaps in found.values():
        yield from sorted(gaps, key=lambda gap: gap.value)[:MOST_CONTACTS]


def _counts(unknowns: Unknowns) -> Bool[np.ndarray, "object object"]:
    """Return the mask of the pairs of objects whose contacts are used.

    At least one of the two objects must be free, and neither may be attached to the other.
    """
    items = unknowns.scene.objects
    free = np.isin(np.arange(len(items)), unknowns.free)
    counts = (free[:, None] | free) & ~np.eye(len(items), dtype=bool)
    for k, item in enumerate(items):
        if item.parent is not None and item.relation == "attached":
            parent = unknowns.scene.index(item.parent)
            counts[k, parent] = counts[parent, k] = False
    return counts
