"""Masks of the objects in the photograph."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Int

from ..spec import Box2D, SceneTree
from .depth_image import nearest_pixels


@dataclass(frozen=True)
class Masks:
    """Pixels that show each object, in an image of the photograph's view at any size."""

    labels: Int[np.ndarray, "row column"] = field(repr=False)
    """Number of the object at each pixel; 0 where no mask is."""
    names: Mapping[str, int] = field(default_factory=dict)
    """Number of each object, by its name in the scene."""
    source: str = ""
    """Source of the masks, for messages."""

    def resized(self, height: int, width: int) -> "Masks":
        """Return the masks at another size, with the value of the nearest pixel."""
        pick = nearest_pixels(self.labels.shape, height, width)
        return Masks(self.labels[pick], self.names, self.source)

    def at(
        self, names: Sequence[str], height: int, width: int
    ) -> dict[int, Bool[np.ndarray, "row column"]]:
        """Return the masks at another size, by the index of the object's name in `names`.

        Objects without a mask, and those whose mask is empty at this size, are missing.
        """
        resized = self.resized(height, width)
        found = {k: resized.of(name) for k, name in enumerate(names)}
        return {k: mask for k, mask in found.items() if mask is not None and mask.any()}

    def with_boxes(self, tree: SceneTree) -> SceneTree:
        """Return a tree whose 2D boxes bound the masks of the objects that have one."""
        height, width = self.labels.shape
        scale = np.array([tree.camera.width / width, tree.camera.height_px / height] * 2)
        nodes = []
        for node in tree.nodes:
            mask = self.of(node.name)
            if mask is not None and mask.any() and not node.environment:
                (rows, columns) = np.nonzero(mask)
                ends = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
                x0, y0, x1, y1 = (scale * ends).tolist()
                node = node.model_copy(update={"box2d": Box2D(x0=x0, y0=y0, x1=x1, y1=y1)})
            nodes.append(node)
        return tree.model_copy(update={"nodes": tuple(nodes)})

    def of(self, name: str) -> Bool[np.ndarray, "row column"] | None:
        """Return the mask of an object, or None if it has none."""
        number = self.names.get(name)
        return None if number is None else self.labels == number
