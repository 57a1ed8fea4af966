"""What the user knows of single objects: an asset in place of a program, a size, or a pose."""

import math
from collections.abc import Mapping
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from ..errors import EvidenceError, choices
from ..spec import ObjectSpec, SceneTree, Spec, TreeNode, bounds
from ..spec.base import Length, Name
from ..spec.opening import parsed_state

Axis = Literal["x", "y", "z"]
AXES: tuple[Axis, ...] = ("x", "y", "z")


class KnownSize(Spec):
    """Lengths of an object as it stands in the photograph [m]; at least one of them."""

    height: Length | None = None
    width: Length | None = None
    """Extent from the left to the right of the object, seen from its front."""
    depth: Length | None = None
    """Extent from the front to the back of the object."""
    diameter: Length | None = None
    """Width and depth of a round object."""

    @model_validator(mode="after")
    def _stated(self) -> "KnownSize":
        if self.diameter is not None and (self.width or self.depth):
            raise ValueError("a diameter is both width and depth: give either it or these")
        if not self.edges:
            raise ValueError("give a height, width, depth or diameter [m]")
        return self

    @property
    def edges(self) -> dict[Axis, float]:
        """Known lengths [m] by the axis of the object."""
        x, y = (self.diameter or value for value in (self.depth, self.width))
        lengths = zip(AXES, (x, y, self.height), strict=True)
        return {axis: length for axis, length in lengths if length is not None}

    def phrase(self) -> str:
        """Return the known lengths in one line."""
        stated = {name: getattr(self, name) for name in type(self).model_fields}
        return ", ".join(f"{name} {v:.4g} m" for name, v in stated.items() if v is not None)


class KnownObjects(Spec):
    """Assets, sizes and poses of objects, by the names of the objects."""

    assets: dict[Name, ObjectSpec] = Field(default_factory=dict, repr=False)
    """Objects in meters that take the place of programs; +x is their front."""
    sizes: dict[Name, KnownSize] = Field(default_factory=dict)
    """Known sizes; that of an asset replaces the size in its file."""
    keep: tuple[Name, ...] = ()
    """Objects whose poses on their supports, and sizes, stay as parsed or annotated."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all objects of which something is known."""
        return tuple(dict.fromkeys((*self.assets, *self.sizes, *self.keep)))

    def check_names(self, tree: SceneTree) -> None:
        """Refuse names that no object of a tree has, and supports without a program.

        Raises:
            EvidenceError: a name is wrong.
        """
        valid = [node.name for node in tree.nodes if not node.slab]
        slabs = {node.name for node in tree.nodes if node.slab}
        keys = {"objects": self.assets, "sizes": self.sizes, "keep": self.keep}
        for key, name in [(key, name) for key, names in keys.items() for name in names]:
            if name in slabs:
                raise EvidenceError(
                    f"{key}: {name} is a flat support of the environment; its height follows from "
                    "that of the camera (--ground), and its outline from the objects on it"
                )
            if name not in valid:
                raise EvidenceError(f"{key}: no such object: {choices(name, valid)}")

    def applied(self, tree: SceneTree, built: Mapping[str, ObjectSpec] | None = None) -> SceneTree:
        """Return a tree whose boxes have the known sizes, and whose cues say what is known.

        Names that the tree lacks are ignored, and positions are not changed. The box of an object
        with a known size gets the proportions of its asset or of the built object, with joints as
        far open as parsed, and otherwise keeps those of its unknown edges.

        Args:
            tree: the scene tree.
            built: the built objects by name, at any size.
        """
        nodes = []
        for node in tree.nodes:
            spec = self.assets.get(node.name, (built or {}).get(node.name))
            if node.name in self.sizes:
                node = _resized(node, spec, self.sizes[node.name].edges)
            elif node.name in self.assets:
                node = _resized(node, spec, {})
            if node.name in self.keep:
                cues = node.cues.model_copy(update={"kept": True})
                node = node.model_copy(update={"cues": cues})
            nodes.append(node)
        return tree.model_copy(update={"nodes": tuple(nodes)})

    def lines(self) -> dict[str, str]:
        """Return a line on each kind of known thing, by its key in an evidence file."""
        lines = {
            "objects": ", ".join(self.assets),
            "sizes": "; ".join(f"{name}: {size.phrase()}" for name, size in self.sizes.items()),
            "keep": ", ".join(self.keep),
        }
        return {key: line for key, line in lines.items() if line}


def _resized(node: TreeNode, spec: ObjectSpec | None, edges: Mapping[Axis, float]) -> TreeNode:
    """Return a node with some known edges [m]; without any, the size is that of `spec`."""
    size = np.array(node.box3d.size)
    if spec is not None:
        low, high = bounds(spec, parsed_state(spec, node)[0])
        size = high - low
    rows, lengths = [AXES.index(axis) for axis in edges], list(edges.values())
    if rows:
        size *= math.exp(float(np.mean(np.log(lengths / size[rows]))))
        if spec is None:
            size[rows] = lengths
    known = tuple(edges) if spec is None else AXES
    box = node.box3d.model_copy(update={"size": tuple(size.tolist())})
    cues = node.cues.model_copy(update={"known_size": known})
    return node.model_copy(update={"box3d": box, "cues": cues})
