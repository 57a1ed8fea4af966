"""Visible parts of candidates that agree with the photograph."""

import jax.numpy as jnp
import numpy as np

from neoworld_mjx.physics.visibility import Outlines, Visible


def as_parsed(photo, pop):
    """Return the visible parts of candidates that match the photograph exactly."""
    repeated = lambda x: jnp.broadcast_to(jnp.asarray(x, jnp.float32), (pop, *np.shape(x)))
    boxes = repeated(photo.boxes)
    x, y = ((boxes[..., k] + boxes[..., k + 2]) / 2 for k in range(2))
    tips = [(boxes[..., 0], y), (x, boxes[..., 1]), (boxes[..., 2], y), (x, boxes[..., 3])]
    extremes = jnp.stack([jnp.stack(tip, axis=-1) for tip in tips], axis=2)
    middle = jnp.stack([x, y], axis=-1)
    projected = Outlines(boxes, extremes, middle, repeated(photo.depth))
    return Visible(boxes, projected)
