"""See-through surfaces, such as glass: what lies behind them shows, composited from back to front.

Of each see-through geom only the side towards the eye is drawn, without refraction.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .ray_caster import Hits, RayCaster


@dataclass(frozen=True)
class Layers:
    """Hits on see-through geoms in front of what is opaque, those of one ray from back to front."""

    row: NDArray
    """Ray of each hit, [m]."""
    hits: Hits
    """[m] rows."""

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
        """Cast rays [n, 3] through the see-through geoms nearer than `reach` [n]."""
        parts = caster.layers(eye, rays, smooth=smooth)
        row = np.concatenate([np.zeros(0, np.int64), *(rows for rows, _ in parts)])
        hits = Hits(
            geom=np.concatenate([np.zeros(0, np.int32), *(h.geom for _, h in parts)]),
            distance=np.concatenate([np.zeros(0), *(h.distance for _, h in parts)]),
            point=np.concatenate([np.zeros((0, 3)), *(h.point for _, h in parts)]),
            normal=np.concatenate([np.zeros((0, 3)), *(h.normal for _, h in parts)]),
        )
        before = np.flatnonzero(hits.distance < reach[row])
        order = before[np.lexsort((-hits.distance[before], row[before]))]
        row = row[order]
        chosen = (hits.geom, hits.distance, hits.point, hits.normal)
        return cls(row, Hits(*(field[order] for field in chosen)))

    def over(self, light: NDArray, paint: Callable[[NDArray, NDArray], NDArray]) -> NDArray:
        """Return light [n, 3] as it arrives through all layers.

        Args:
            light: of what is opaque, along each ray [n, 3].
            paint: returns the light [k, 3] of some hits, given their indices [k] and the light that
                arrives behind them [k, 3].
        """
        if not len(self.row):
            return light
        light = light.copy()
        first = np.searchsorted(self.row, self.row, side="left")
        rank = np.arange(len(self.row)) - first
        for k in range(int(rank.max()) + 1):
            chosen = np.flatnonzero(rank == k)
            rows = self.row[chosen]
            light[rows] = paint(chosen, light[rows])
        return light

    def nearest(self) -> NDArray:
        """Return the index of each ray's nearest hit, for the rays that have one."""
        return np.flatnonzero(np.append(self.row[1:] != self.row[:-1], len(self.row) > 0))
