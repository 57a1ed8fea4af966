"""Masks of the objects in the photograph."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Int


@dataclass(frozen=True)
class Masks:
    """Pixels that show each object, in an image of the photograph's view at any size."""

    labels: Int[np.ndarray, "row column"] = field(repr=False)
    """Number of the object at each pixel; 0 where no mask is."""
    names: Mapping[str, int] = field(default_factory=dict)
    """Number of each object, by its name in the scene."""
    source: str = ""
    """Where the masks come from; for messages."""

    def resized(self, height: int, width: int) -> "Masks":
        """Return the masks at another size, with the value of the nearest pixel."""
        rows, columns = (
            np.minimum(((np.arange(n) + 0.5) * old / n).astype(int), old - 1)
            for n, old in zip((height, width), self.labels.shape, strict=True)
        )
        return Masks(self.labels[np.ix_(rows, columns)], self.names, self.source)

    def of(self, name: str) -> Bool[np.ndarray, "row column"] | None:
        """Return the mask of an object, or None if it has none."""
        number = self.names.get(name)
        return None if number is None else self.labels == number
