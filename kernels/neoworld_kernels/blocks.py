"""Surface samples in blocks of neighboring points, with bounding spheres."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

BLOCK = 32
"""Largest number of samples in a block."""


class Blocks(NamedTuple):
    """Samples of all objects in blocks, with bounding spheres."""

    points: Float[Array, "object block sample 3"]
    centre: Float[Array, "object block 3"]
    radius: Float[Array, "object block"]


def sorted_samples(
    samples: Float[NDArray, "object sample 3"], first: int = 2 * BLOCK
) -> Float[NDArray, "object sample 3"]:
    """Reorder each object's samples so that each block of BLOCK consecutive samples is compact.

    The first `first` samples are the most important ones. They stay in front and are reordered
    among themselves.
    """

    def split_in_half(points: NDArray) -> NDArray:
        if len(points) <= BLOCK:
            return points
        order = np.argsort(points[:, np.argmax(np.ptp(points, axis=0))], kind="stable")
        half = -(-len(points) // (2 * BLOCK)) * BLOCK
        return np.concatenate(
            [split_in_half(points[order[:half]]), split_in_half(points[order[half:]])]
        )

    return np.stack(
        [np.concatenate([split_in_half(x[:first]), split_in_half(x[first:])]) for x in samples]
    )


def sample_blocks(samples: Float[Array, "object sample 3"]) -> Blocks:
    """Split the samples of each object into blocks of consecutive samples."""
    count, number, _ = samples.shape
    size = min(BLOCK, number)
    points = jnp.pad(samples, ((0, 0), (0, -number % size), (0, 0)), mode="edge")
    points = points.reshape(count, -1, size, 3)
    return Blocks(points, *bounding_sphere(points))


def bounding_sphere(points: Float[Array, "... sample 3"]) -> tuple[Array, Array]:
    """Return the centers [..., 3] and radii [...] of spheres that bound points [m]."""
    centre = (points.min(axis=-2) + points.max(axis=-2)) / 2
    radius = jnp.sqrt(jnp.max(jnp.sum((points - centre[..., None, :]) ** 2, axis=-1), axis=-1))
    # The radius is slightly enlarged, so that rounding never culls a contact.
    return centre, radius * 1.00001 + 1e-6
