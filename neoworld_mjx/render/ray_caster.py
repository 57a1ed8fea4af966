"""Rays against a MuJoCo model: hits with smooth normals, and whether one point sees another.

`mujoco.mj_multiRay` needs no OpenGL, gives the same result on every machine, and lets go of the
interpreter's lock; it writes to its MjData's stack, so each thread has its own.
"""

import copy
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..physics.mjcf import VISUAL_GROUP
from ..spec.object import OPAQUE_ALPHA
from ..spec.triangles import corner_normals

if TYPE_CHECKING:
    from scipy.spatial import KDTree

FAR = 1e10
SEE_THROUGH_GROUP, LAYER_GROUP = 5, 4
"""Groups, in a caster's own copy of the model, of see-through geoms and of the one to be cast."""
FAR_BOX_M = 1e4
"""Half an edge of a box that holds everything."""


@dataclass(frozen=True)
class Hits:
    """First hit of every ray, one row each."""

    geom: NDArray
    """Geom id, -1 for nothing, int32 [n]."""
    distance: NDArray
    """Along the ray, in lengths of its direction; inf for nothing, [n]."""
    point: NDArray
    """[m], [n, 3]; meaningless for nothing."""
    normal: NDArray
    """Outward unit normal, smooth over meshes, [n, 3]; zero for nothing."""


class RayCaster:
    """A posed model, ready for rays."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, threads: int | None = None):
        self.model, self.data = _without_culling(model), data
        count = threads or min(4, os.cpu_count() or 1)
        self._datas = [data, *(copy.copy(data) for _ in range(count - 1))]
        visual = model.geom_group == VISUAL_GROUP
        self.shown: NDArray = visual if visual.any() else model.geom_group <= 2
        """Which geoms are drawn [geom]: the visual ones, or where a model has none, all."""
        self._opaque = np.zeros(6, np.uint8)
        self._opaque[np.unique(model.geom_group[self.shown])] = 1
        self.alpha: NDArray = model.geom_rgba[:, 3].copy()
        """Opacity of each geom [geom]."""
        with_material = model.geom_matid >= 0
        self.alpha[with_material] = model.mat_rgba[model.geom_matid[with_material], 3]
        self.see_through: NDArray = np.flatnonzero(
            self.shown & (self.alpha > 0) & (self.alpha < OPAQUE_ALPHA)
        )
        """Ids of the drawn geoms that show what is behind them."""
        self.model.geom_group[self.see_through] = SEE_THROUGH_GROUP
        self._all = self._opaque.copy()
        self._all[SEE_THROUGH_GROUP] = 1
        self._smooth: dict[int, _Smooth] = {}

    def hits(
        self, eye: NDArray, directions: NDArray, *, smooth: bool = True, opaque: bool = False
    ) -> Hits:
        """Cast rays [n, 3] from one point [3] m.

        Args:
            eye: the point.
            directions: the rays.
            smooth: whether meshes show smooth normals, or those of their facets.
            opaque: whether rays go through see-through geoms, or stop there.
        """
        return self._hits(eye, directions, self._opaque if opaque else self._all, smooth)

    def layers(
        self, eye: NDArray, directions: NDArray, *, smooth: bool = True
    ) -> list[tuple[NDArray, Hits]]:
        """Return the hits on the near side of each see-through geom, opaque ones left out.

        Returns:
            For each geom that is hit the rows of `directions`, and their hits.
        """
        hits_by_rows = []
        length = np.linalg.norm(directions, axis=1)
        one = np.zeros(6, np.uint8)
        one[LAYER_GROUP] = 1
        for g in self.see_through.tolist():
            rows = np.flatnonzero(self._near(g, eye, directions, length))
            self.model.geom_group[g] = LAYER_GROUP
            hits = self._hits(eye, directions[rows], one, smooth)
            self.model.geom_group[g] = SEE_THROUGH_GROUP
            on = np.flatnonzero(hits.geom >= 0)
            if len(on):
                own = (hits.geom, hits.distance, hits.point, hits.normal)
                hits_by_rows.append((rows[on], Hits(*(field[on] for field in own))))
        return hits_by_rows

    def _near(self, g: int, eye: NDArray, directions: NDArray, length: NDArray) -> NDArray:
        """Tell which rays pass a geom's bounding sphere."""
        to_middle = self.data.geom_xpos[g] - eye
        along = directions @ to_middle / length
        radius = float(self.model.geom_rbound[g])
        beside = np.maximum(to_middle @ to_middle - along**2, 0.0) < radius**2 * 1.0001
        return beside & (along > -radius)

    def _hits(self, eye: NDArray, directions: NDArray, groups: NDArray, smooth: bool) -> Hits:
        geom, distance, normal = self._cast(eye, directions, groups, normals=True)
        point = eye + directions * np.where(geom >= 0, distance, 0.0)[:, None]
        assert normal is not None
        if smooth:
            self._smoothen(geom, point, normal)
        normal[geom < 0] = 0.0
        return Hits(geom, np.where(geom >= 0, distance, np.inf), point, normal)

    def visible(self, source: NDArray, points: NDArray) -> NDArray:
        """Return the share of light that reaches points [n, 3] from a source [3], [n] in [0, 1].

        See-through geoms let through what they do not cover, the nearest to the source alone.
        """
        rays = points - source
        geom, distance, _ = self._cast(source, rays, self._opaque, normals=False)
        share = ((geom < 0) | (distance >= 1.0 - 1e-9)).astype(float)
        if len(self.see_through):
            length = np.linalg.norm(rays, axis=1)
            near = np.zeros(len(rays), bool)
            for g in self.see_through.tolist():
                near |= self._near(g, source, rays, length)
            rows = np.flatnonzero(near & (share > 0))
            geom, distance, _ = self._cast(source, rays[rows], self._all, normals=False)
            between = (geom >= 0) & (distance < 1.0 - 1e-9)
            share[rows[between]] = 1.0 - self.alpha[geom[between]]
        return share

    def _cast(
        self, eye: NDArray, directions: NDArray, groups: NDArray, *, normals: bool
    ) -> tuple[NDArray, NDArray, NDArray | None]:
        n = len(directions)
        rays = np.ascontiguousarray(directions, float).reshape(-1)
        geom, distance = np.empty(n, np.int32), np.empty(n)
        normal = np.empty(3 * n) if normals else None
        workers = len(self._datas) if n > 4096 else 1
        cuts = np.linspace(0, n, workers + 1).astype(int)

        def work(k: int) -> None:
            low, high = int(cuts[k]), int(cuts[k + 1])
            if low == high:
                return
            mujoco.mj_multiRay(
                self.model,
                self._datas[k],
                np.asarray(eye, float),
                rays[3 * low : 3 * high],
                groups,
                True,
                -1,
                geom[low:high],
                distance[low:high],
                None if normal is None else normal[3 * low : 3 * high],
                high - low,
                FAR,
            )

        if workers == 1:
            work(0)
        else:
            with ThreadPoolExecutor(workers) as pool:
                list(pool.map(work, range(workers)))
        return geom, distance, None if normal is None else normal.reshape(-1, 3)

    def _smoothen(self, geom: NDArray, point: NDArray, normal: NDArray) -> None:
        """Replace the facet normals of mesh hits by normals interpolated over the facet."""
        data = self.data
        for g in np.unique(geom):
            if g < 0 or self.model.geom_type[g] != mujoco.mjtGeom.mjGEOM_MESH:
                continue
            mesh = int(self.model.geom_dataid[g])
            if mesh not in self._smooth:
                self._smooth[mesh] = _Smooth.of(self.model, mesh)
            rows = np.flatnonzero(geom == g)
            turn = data.geom_xmat[g].reshape(3, 3)
            local = (point[rows] - data.geom_xpos[g]) @ turn
            normal[rows] = self._smooth[mesh].normals(local, normal[rows] @ turn) @ turn.T


def _without_culling(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy whose bodies' outermost boxes hold every eye.

    `mj_multiRay` culls bodies by the angles of their boxes' corners, and where a box is not
    parallel to the world (that of a body with a turned inertial frame) it culls too much: legs of
    tables and corners of cabinets vanish. An eye within the box sees all of it.
    """
    model = copy.copy(model)
    roots = model.body_bvhadr[model.body_bvhadr >= 0]
    model.bvh_aabb[roots, 3:] = FAR_BOX_M
    return model


@dataclass(frozen=True)
class _Smooth:
    """Finds the facet of a mesh that a ray has hit, which MuJoCo does not tell, by its plane."""

    tree: "KDTree"
    reach: float
    corners: NDArray
    """[f, 3, 3] m"""
    normals_at: NDArray
    """At the corners, [f, 3, 3]."""

    @classmethod
    def of(cls, model: mujoco.MjModel, mesh: int) -> "_Smooth":
        from scipy.spatial import KDTree

        v0, f0 = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
        vertices = model.mesh_vert[v0 : v0 + model.mesh_vertnum[mesh]].astype(float)
        faces = model.mesh_face[f0 : f0 + model.mesh_facenum[mesh]].astype(int)
        corners = vertices[faces]
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-30)
        reach = float(np.abs(vertices).max()) or 1.0
        offset = np.sum(flat * corners.mean(axis=1), axis=1) / reach
        tree = KDTree(_key(flat, offset, corners.mean(axis=1) / reach))
        return cls(tree, reach, corners, corner_normals(vertices, faces))

    def normals(self, points: NDArray, flat: NDArray) -> NDArray:
        """Interpolate at points [n, 3] on facets with normals [n, 3], in the mesh's frame."""
        offset = np.sum(flat * points, axis=1) / self.reach
        count = min(3, len(self.corners))
        _, near = self.tree.query(_key(flat, offset, points / self.reach), k=count)
        best, weights = self._weights(points, near.reshape(len(points), -1))
        mixed = np.einsum("nk,nkx->nx", weights, self.normals_at[best])
        length = np.linalg.norm(mixed, axis=1, keepdims=True)
        return np.where(length > 0.1, mixed / np.maximum(length, 1e-30), flat)

    def _weights(self, points: NDArray, near: NDArray) -> tuple[NDArray, NDArray]:
        """Choose the candidate facet [n, k] that holds each point; return it and barycentrics."""
        best = near[:, 0].copy()
        weights = _barycentric(points, self.corners[best])
        for k in range(1, near.shape[1]):
            other = _barycentric(points, self.corners[near[:, k]])
            better = other.min(axis=1) > weights.min(axis=1)
            best[better], weights[better] = near[better, k], other[better]
        weights = np.clip(weights, 0.0, 1.0)
        return best, weights / weights.sum(axis=1, keepdims=True)


def _key(normal: NDArray, offset: NDArray, place: NDArray) -> NDArray:
    # Facets of one plane are distinguished by place; planes, which a ray knows exactly, come first.
    return np.column_stack([100.0 * normal, 100.0 * offset, place])


def _barycentric(points: NDArray, corners: NDArray) -> NDArray:
    a = corners[:, 0]
    u, v, w = corners[:, 1] - a, corners[:, 2] - a, points - a
    uu, uv, vv = (np.einsum("nx,nx->n", x, y) for x, y in ((u, u), (u, v), (v, v)))
    wu, wv = np.einsum("nx,nx->n", w, u), np.einsum("nx,nx->n", w, v)
    det = np.maximum(uu * vv - uv * uv, 1e-300)
    s, t = (vv * wu - uv * wv) / det, (uu * wv - uv * wu) / det
    return np.stack([1.0 - s - t, s, t], axis=1)
