"""Composite transparent surfaces, such as glass, from back to front.

Only the front of each transparent geom is rendered, without refraction.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .ray_caster import Hits, RayCaster


@dataclass(frozen=True)
class Layers:
    """Hits on transparent geoms in front of opaque ones, sorted by ray, then from back to front."""

    ray: NDArray
    """Index of the ray of each hit, shape [hit]."""
    hits: Hits
    """The hits; their rows correspond to the entries of `ray`."""

    @classmethod
    def cast(
        cls,
        caster: RayCaster,
        eye: NDArray,
        rays: NDArray,
        reach: NDArray,
        *,
        smooth: bool = True,
    ) -> "Layers":
        """Return the hits of rays [n, 3] on transparent geoms at distances below `reach` [n]."""
        parts = caster.layers(eye, rays, smooth=smooth)
        ray = np.concatenate([np.zeros(0, np.int64), *(rows for rows, _ in parts)])
        hits = Hits(
            geom=np.concatenate([np.zeros(0, np.int32), *(h.geom for _, h in parts)]),
            distance=np.concatenate([np.zeros(0), *(h.distance for _, h in parts)]),
            point=np.concatenate([np.zeros((0, 3)), *(h.point for _, h in parts)]),
            normal=np.concatenate([np.zeros((0, 3)), *(h.normal for _, h in parts)]),
        )
        before = np.flatnonzero(hits.distance < reach[ray])
        order = before[np.lexsort((-hits.distance[before], ray[before]))]
        return cls(ray[order], hits.rows(order))

    def over(self, light: NDArray, paint: Callable[[NDArray, NDArray], NDArray]) -> NDArray:
        """Return the light [n, 3] along each ray after it passes through all layers.

        Args:
            light: light from opaque surfaces along each ray, shape [n, 3].
            paint: function that receives the indices of hits [k] and the light behind these hits
                [k, 3], and returns the light in front of them [k, 3].
        """
        if not len(self.ray):
            return light
        light = light.copy()
        first = np.searchsorted(self.ray, self.ray, side="left")
        rank = np.arange(len(self.ray)) - first
        for k in range(int(rank.max()) + 1):
            chosen = np.flatnonzero(rank == k)
            rows = self.ray[chosen]
            light[rows] = paint(chosen, light[rows])
        return light

    def nearest(self) -> NDArray:
        """Return the index of the nearest hit of each ray that hits a transparent geom."""
        return np.flatnonzero(np.append(self.ray[1:] != self.ray[:-1], len(self.ray) > 0))
