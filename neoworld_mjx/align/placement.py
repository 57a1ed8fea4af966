"""Camera and poses of all bodies of a scene at some values of the unknowns."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..spec import Camera


@dataclass(frozen=True)
class Placement:
    """Camera and poses of all bodies at some values of the unknowns.

    Points of a body are in the frame of its object, as composed and at scale 1.
    """

    camera: Camera
    pos: Float[np.ndarray, "body 3"]
    """Origins [m]; of objects first."""
    turn: Float[np.ndarray, "body 3 3"]
    """Rotations."""
    scale: Float[np.ndarray, " body"]

    def world(
        self, body: int | Int[np.ndarray, " n"], points: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Transform points of a body, or each of its own, to the world."""
        if isinstance(body, int):
            return self.scale[body] * points @ self.turn[body].T + self.pos[body]
        turned = np.einsum("nij,nj->ni", self.turn[body], points)
        return self.scale[body, None] * turned + self.pos[body]

    def local(
        self, body: int | Int[np.ndarray, " n"], points: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Transform points in the world to a body, or each to its own."""
        if isinstance(body, int):
            return (points - self.pos[body]) @ self.turn[body] / self.scale[body]
        turned = np.einsum("nji,nj->ni", self.turn[body], points - self.pos[body])
        return turned / self.scale[body, None]
