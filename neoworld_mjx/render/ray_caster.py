"""Cast rays against a MuJoCo model: hits with smooth normals, and visibility between points.

`mujoco.mj_multiRay` needs no OpenGL, gives the same result on every machine and releases the GIL.
It writes to the stack of an MjData, so each thread uses a separate MjData.
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
from .appearance import geom_rgba

if TYPE_CHECKING:
    from scipy.spatial import KDTree

FAR = 1e10
SEE_THROUGH_GROUP, LAYER_GROUP = 5, 4
"""Geom groups in the ray caster's copy of the model: the first for transparent geoms, the second
for the one transparent geom at which `RayCaster.layers` casts rays."""
FAR_BOX_M = 1e4
"""Half the edge length [m] of a box that contains the origin of every ray."""


@dataclass(frozen=True)
class Hits:
    """First hit of each ray. Every array has one row per ray."""

    geom: NDArray
    """Geom id, int32 [n]; -1 for a miss."""
    distance: NDArray
    """Distance as a multiple of the length of the ray's direction vector [n]; inf for a miss."""
    point: NDArray
    """Point of the hit in the world frame [m], shape [n, 3]; the origin of the ray for a miss."""
    normal: NDArray
    """Outward unit normal in the world frame, shape [n, 3]; zero for a miss."""

    def rows(self, index: NDArray) -> "Hits":
        """Return the hits of the rays with the given indices."""
        return Hits(self.geom[index], self.distance[index], self.point[index], self.normal[index])


class RayCaster:
    """Ray caster of a posed model."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self.model, self.data = _without_culling(model), data
        threads = min(4, os.cpu_count() or 1)
        self._datas = [data, *(copy.copy(data) for _ in range(threads - 1))]
        visual = model.geom_group == VISUAL_GROUP
        self.shown: NDArray = visual if visual.any() else model.geom_group <= 2
        """Mask of the rendered geoms [geom]: visual geoms or, if there are none, groups 0 to 2."""
        self._opaque = np.zeros(6, np.uint8)
        self._opaque[np.unique(model.geom_group[self.shown])] = 1
        self.alpha: NDArray = geom_rgba(model)[:, 3]
        """Opacity of each geom [geom]."""
        self.see_through: NDArray = np.flatnonzero(
            self.shown & (self.alpha > 0) & (self.alpha < OPAQUE_ALPHA)
        )
        """Ids of the rendered geoms that are transparent."""
        self.model.geom_group[self.see_through] = SEE_THROUGH_GROUP
        self._all = self._opaque.copy()
        self._all[SEE_THROUGH_GROUP] = 1
        self._smooth: dict[int, _Smooth] = {}

    def hits(
        self, eye: NDArray, directions: NDArray, *, smooth: bool = True, opaque: bool = False
    ) -> Hits:
        """Cast rays from one point.

        Args:
            eye: origin of the rays [m], shape [3].
            directions: directions of the rays, shape [n, 3].
            smooth: if True, interpolate normals over meshes; if False, return normals of facets.
            opaque: if True, rays pass through transparent geoms.
        """
        return self._hits(eye, directions, self._opaque if opaque else self._all, smooth)

    def layers(
        self, eye: NDArray, directions: NDArray, *, smooth: bool = True
    ) -> list[tuple[NDArray, Hits]]:
        """Cast rays at each transparent geom separately, as if there were no other geoms.

        Returns:
            One pair for each geom that is hit: the indices of the rays that hit it, and their hits.
        """
        hits_by_geom = []
        length = np.linalg.norm(directions, axis=1)
        layer = np.zeros(6, np.uint8)
        layer[LAYER_GROUP] = 1
        for g in self.see_through.tolist():
            rows = np.flatnonzero(self._near(g, eye, directions, length))
            self.model.geom_group[g] = LAYER_GROUP
            hits = self._hits(eye, directions[rows], layer, smooth)
            self.model.geom_group[g] = SEE_THROUGH_GROUP
            hit = np.flatnonzero(hits.geom >= 0)
            if len(hit):
                hits_by_geom.append((rows[hit], hits.rows(hit)))
        return hits_by_geom

    def _near(self, g: int, eye: NDArray, directions: NDArray, length: NDArray) -> NDArray:
        """Return a mask [n] of the rays that hit the bounding sphere of a geom."""
        to_middle = self.data.geom_xpos[g] - eye
        along = directions @ to_middle / length
        radius = float(self.model.geom_rbound[g])
        within = np.maximum(to_middle @ to_middle - along**2, 0.0) < radius**2 * 1.0001
        return within & (along > -radius)

    def _hits(self, eye: NDArray, directions: NDArray, groups: NDArray, smooth: bool) -> Hits:
        geom, distance, normal = self._cast(eye, directions, groups, normals=True)
        point = eye + directions * np.where(geom >= 0, distance, 0.0)[:, None]
        assert normal is not None
        if smooth:
            self._smoothen(geom, point, normal)
        normal[geom < 0] = 0.0
        return Hits(geom, np.where(geom >= 0, distance, np.inf), point, normal)

    def visible(self, source: NDArray, points: NDArray) -> NDArray:
        """Return the fraction [n] of the light from a source [3] that reaches each point [n, 3].

        If a ray crosses several transparent geoms, only the geom nearest to the source attenuates
        the light.
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
        """Interpolate the normals of hits on meshes, in place."""
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
    """Return a copy of a model in which the bounding box of each body contains every ray's origin.

    `mj_multiRay` culls a body if a ray lies outside the range of angles that the corners of the
    body's box span. If the box is not axis-aligned, because the body has a rotated inertial frame,
    the range is too small: table legs and cabinet corners vanish. A body whose box contains the
    origin of the rays is not culled.
    """
    model = copy.copy(model)
    roots = model.body_bvhadr[model.body_bvhadr >= 0]
    model.bvh_aabb[roots, 3:] = FAR_BOX_M
    return model


@dataclass(frozen=True)
class _Smooth:
    """Search tree that finds the facet that a ray has hit, which MuJoCo does not report."""

    tree: "KDTree"
    reach: float
    """Largest coordinate of the mesh [m]."""
    corners: NDArray
    """Corners of the facets [m], shape [f, 3, 3]."""
    normals_at: NDArray
    """Normals at the corners, shape [f, 3, 3]."""

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
        """Return smooth normals at points [n, 3], given the normals of their facets [n, 3]."""
        offset = np.sum(flat * points, axis=1) / self.reach
        count = min(3, len(self.corners))
        _, near = self.tree.query(_key(flat, offset, points / self.reach), k=count)
        best, weights = self._weights(points, near.reshape(len(points), -1))
        mixed = np.einsum("nk,nkx->nx", weights, self.normals_at[best])
        length = np.linalg.norm(mixed, axis=1, keepdims=True)
        return np.where(length > 0.1, mixed / np.maximum(length, 1e-30), flat)

    def _weights(self, points: NDArray, near: NDArray) -> tuple[NDArray, NDArray]:
        """Return which nearby facet [n, k] contains each point, and the barycentric coordinates."""
        best = near[:, 0].copy()
        weights = _barycentric(points, self.corners[best])
        for k in range(1, near.shape[1]):
            other = _barycentric(points, self.corners[near[:, k]])
            better = other.min(axis=1) > weights.min(axis=1)
            best[better], weights[better] = near[better, k], other[better]
        weights = np.clip(weights, 0.0, 1.0)
        return best, weights / weights.sum(axis=1, keepdims=True)


def _key(normal: NDArray, offset: NDArray, position: NDArray) -> NDArray:
    # The plane of the facet is known exactly, so it has a larger weight than the position.
    return np.column_stack([100.0 * normal, 100.0 * offset, position])


def _barycentric(points: NDArray, corners: NDArray) -> NDArray:
    a = corners[:, 0]
    u, v, w = corners[:, 1] - a, corners[:, 2] - a, points - a
    uu, uv, vv = (np.einsum("nx,nx->n", x, y) for x, y in ((u, u), (u, v), (v, v)))
    wu, wv = np.einsum("nx,nx->n", w, u), np.einsum("nx,nx->n", w, v)
    det = np.maximum(uu * vv - uv * uv, 1e-300)
    s, t = (vv * wu - uv * wv) / det, (uu * wv - uv * wu) / det
    return np.stack([1.0 - s - t, s, t], axis=1)
