"""A small scene as an answer, as a tree with exact boxes, and a blank photo of it."""

import math
from pathlib import Path

import numpy as np

from neoworld_mjx.parse.outlines import expected_box
from neoworld_mjx.parse.photo import Photo
from neoworld_mjx.parse.schema import ParsedScene, to_tree
from neoworld_mjx.spec import Box2D, SceneTree

SIZE = (800, 600)


def photo(size=SIZE, original=None):
    grey = np.full((size[1], size[0], 3), 128, np.uint8)
    return Photo(grey, original or size, "0" * 64, Path("blank.png"))


def item(name, at=(0.8, 0.0, 0.0), size=(0.1, 0.1, 0.1), **extra):
    return {
        "name": name,
        "label": "box",
        "description": "",
        "parent": "table",
        "box": {"left": 10, "top": 10, "right": 90, "bottom": 90},
        "position": dict(zip("xyz", at, strict=True)),
        "size": dict(zip(("length", "width", "height"), size, strict=True)),
        **extra,
    }


def table(**extra):
    whole = {"left": 0, "top": 0, "right": SIZE[0], "bottom": SIZE[1]}
    fields = {"label": "table top", "environment": True, "parent": None, "box": whole, **extra}
    return item("table", (1.0, 0, -0.03), (1.6, 1.6, 0.03), **fields)


def answer(*objects, **camera):
    view = {"pitch_deg": 35.0, "height": 0.55, "fovy_deg": 40.0, **camera}
    return {"camera": view, "objects": [table(), *objects]}


def desk():
    """Two boxes side by side, one with a can on it."""
    return answer(
        item("left", (0.8, 0.2, 0.0), (0.2, 0.15, 0.08), yaw_deg=20),
        item("right", (0.75, -0.15, 0.0), (0.1, 0.14, 0.12), yaw_deg=-35),
        item("can", (0.81, 0.21, 0.08), (0.066, 0.066, 0.12), label="soda can", parent="left"),
    )


def exact(data=None) -> SceneTree:
    """The tree of an answer, its 2D boxes those of its 3D boxes."""
    tree = to_tree(ParsedScene.model_validate(data or desk()), photo())
    nodes = []
    for node in tree.nodes:
        corners = expected_box(tree.camera, node)
        assert corners is not None, f"{node.name} is out of the picture"
        x0, y0, x1, y1 = corners
        box = Box2D(x0=x0, y0=y0, x1=x1, y1=y1)
        nodes.append(node.model_copy(update={"box2d": box}))
    return SceneTree(camera=tree.camera, nodes=tuple(nodes))


def with_node(tree, name, **update):
    nodes = tuple(n.model_copy(update=update) if n.name == name else n for n in tree.nodes)
    return SceneTree(camera=tree.camera, nodes=nodes)


def moved(tree, name, position=None, size=None, yaw=None):
    box = tree.node(name).box3d
    update = {}
    if position is not None:
        update["position"] = tuple(np.add(box.position, position).tolist())
    if size is not None:
        update["size"] = tuple(np.multiply(box.size, size).tolist())
    if yaw is not None:
        update["yaw"] = box.yaw + math.radians(yaw)
    return with_node(tree, name, box3d=box.model_copy(update=update))
