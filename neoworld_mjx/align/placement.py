"""Camera and poses of all bodies of a scene at some values of the unknowns."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..spec import Camera


@dataclass(frozen=True)
class Placement:
    """Camera and poses of all bodies at some values of the unknowns.

    Points of a body are in the frame of the body's object, at the composed joint values and scale
    1.
    """

    camera: Camera
    pos: Float[np.ndarray, "body 3"]
    """Origins in the world frame [m]; objects come first, then moving parts."""
    turn: Float[np.ndarray, "body 3 3"]
    """Rotation matrices from the body to the world frame."""
    scale: Float[np.ndarray, " body"]

    def world(
        self, body: int | Int[np.ndarray, " n"], points: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Transform points from body frames to the world; `body` is one index, or one per point."""
        if isinstance(body, int):
            return self.scale[body] * points @ self.turn[body].T + self.pos[body]
        turned = np.einsum("nij,nj->ni", self.turn[body], points)
        return self.scale[body, None] * turned + self.pos[body]

    def local(
        self, body: int | Int[np.ndarray, " n"], points: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Transform points from the world to body frames; `body` is one index, or one per point."""
        if isinstance(body, int):
            return (points - self.pos[body]) @ self.turn[body] / self.scale[body]
        turned = np.einsum("nji,nj->ni", self.turn[body], points - self.pos[body])
        return turned / self.scale[body, None]
