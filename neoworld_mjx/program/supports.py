"""Programs of the environment's supports, written from the parsed boxes without a model.

The paper uses static primitives, such as a slab for a floor, a counter or a wall. Here, the slab
has the support's outline, and freestanding tables have legs.
"""

from collections.abc import Sequence

import numpy as np

from ..spec import SupportOutline, TreeNode
from ..spec.outlines import loops_distance
from ..spec.surface_pattern import RGB
from .materials import MATERIALS

LEGGED = ("table", "desk", "bench", "stool")
MIN_LEGGED_HEIGHT_M = 0.25
BOARD_M, LEG_M = 0.04, 0.06
ROUND_WITHIN = 1e-3
"""Largest relative difference between length and width at which a round slab is a cylinder."""
_MATERIALS = {
    "glass": "glass",
    "marble": "marble",
    "granite": "stone",
    "stone": "stone",
    "quartz": "stone",
    "concrete": "concrete",
    "tile": "ceramic",
    "metal": "steel",
    "steel": "steel",
    "carpet": "fabric",
    "cloth": "fabric",
    "plastic": "plastic",
    "wall": "concrete",
}

_SLAB = """from neoworld_mjx.program.sdk import Object, {call}

support = Object("{name}")
surface = support.material("{like}_surface", like="{like}"{look})
body = support.part("body", material=surface)
body.add({slab}, by="bottom", name="slab")
"""
_TABLE = """from neoworld_mjx.program.sdk import Object, box

X, Y, Z = {x!r}, {y!r}, {z!r}
BOARD, LEG = {board!r}, {leg!r}

support = Object("{name}")
surface = support.material("{like}_surface", like="{like}"{look})
body = support.part("body", material=surface)
body.add(box((X, Y, BOARD)), at=(0, 0, Z), by="top", name="board")
for i, sx in enumerate((-1, 1)):
    for j, sy in enumerate((-1, 1)):
        foot = (sx * (X - LEG) / 2, sy * (Y - LEG) / 2, 0)
        body.add(box((LEG, LEG, Z - BOARD)), at=foot, by="bottom", name=f"leg_{{i}}{{j}}")
"""
_OUTLINED_TABLE = """from neoworld_mjx.program.sdk import Object, {calls}

Z, BOARD, LEG = {z!r}, {board!r}, {leg!r}

support = Object("{name}")
surface = support.material("{like}_surface", like="{like}"{look})
body = support.part("body", material=surface)
body.add({slab}, at=(0, 0, Z), by="top", name="board")
for i, (x, y) in enumerate({feet!r}):
    body.add(cylinder(LEG / 2, Z - BOARD), at=(x, y, 0), by="bottom", name=f"leg_{{i}}")
"""


def support_program(node: TreeNode, rgb: tuple[float, float, float] | None = None) -> str:
    """Return the program of a support that fills the support's outline and parsed box.

    `rgb` is the support's color in the photo, from 0 to 1. If None, the color is that of the parsed
    surface, or else that of the material.
    """
    x, y, z = (round(v, 6) for v in node.box3d.size)
    like, look = _appearance(node, rgb)
    label = node.label.lower()
    legged = z >= MIN_LEGGED_HEIGHT_M and any(word in label for word in LEGGED)
    legged &= min(x, y) > 4 * LEG_M
    common = {"name": node.name, "like": like, "look": look}
    if node.outline.shape == "rectangle" and legged:
        return _TABLE.format(**common, x=x, y=y, z=z, board=BOARD_M, leg=LEG_M)
    feet = leg_positions(node.outline, x, y) if legged else []
    if len(feet) >= 3:
        call, slab = _slab(node, x, y, "BOARD")
        calls = ", ".join(sorted({call, "cylinder"}))
        numbers = {"z": z, "board": BOARD_M, "leg": LEG_M}
        return _OUTLINED_TABLE.format(**common, **numbers, calls=calls, slab=slab, feet=feet)
    call, slab = _slab(node, x, y, repr(z))
    return _SLAB.format(**common, call=call, slab=slab)


def leg_positions(outline: SupportOutline, x: float, y: float) -> list[tuple[float, float]]:
    """Return leg positions [m] near the corners of a table top whose size is (x, y) [m]."""
    corners = outline.corners() * [x, y]
    to_next = np.roll(corners, -1, axis=0) - corners
    to_next /= np.linalg.norm(to_next, axis=1, keepdims=True)
    to_last = -np.roll(to_next, 1, axis=0)
    half = np.arccos(np.clip(np.sum(to_next * to_last, axis=1), -1, 1)) / 2
    convex = to_next[:, 0] * to_last[:, 1] - to_next[:, 1] * to_last[:, 0] > 1e-6
    inwards = to_next + to_last
    inwards /= np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-9)
    candidates = (corners + inwards * (LEG_M / 2 / np.sin(half))[:, None])[convex]
    if outline.shape == "round":
        signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
        candidates = signs * (np.array([x, y]) / 2 - LEG_M) / np.sqrt(2)
    is_below_top = -loops_distance(candidates, [corners]) > 0.999 * LEG_M / 2
    positions: list[tuple[float, float]] = []
    for candidate in candidates[is_below_top]:
        if all(np.hypot(*(candidate - other)) > 2 * LEG_M for other in positions):
            px, py = (round(v, 4) for v in candidate.tolist())
            positions.append((px, py))
    return positions


def _appearance(node: TreeNode, rgb: RGB | None) -> tuple[str, str]:
    """Return the named material of a support, and the source of its color and pattern arguments.

    If the photo's color replaces the parsed color, the color of joints and veins is scaled so that
    their contrast is preserved.
    """
    if node.surface is None:
        description = f"{node.label} {node.description}".lower()
        like = next(
            (name for keyword, name in _MATERIALS.items() if keyword in description), "wood"
        )
        look = "" if rgb is None else f", rgb={_triple(rgb)}"
        return like, look + (', pattern="veins"' if "vein" in description else "")
    surface, pattern = node.surface, node.surface.pattern
    look, color = "", rgb or surface.rgb
    if color is not None:
        look = f", rgb={_triple(color)}"
        alpha = MATERIALS[surface.material].rgba[3]
        look += f", alpha={alpha!r}" if alpha < 1 else ""
    look += f', pattern="{pattern.kind}"'
    second: Sequence[float] | None = pattern.rgb
    if second is not None and rgb is not None and surface.rgb is not None:
        second = [
            min(1.0, value * (new + 0.05) / (old + 0.05))
            for value, new, old in zip(second, rgb, surface.rgb, strict=True)
        ]
    look += "" if second is None else f", rgb2={_triple(second)}"
    look += "" if pattern.step is None else f", step={pattern.step!r}"
    look += "" if pattern.along == "x" else f', along="{pattern.along}"'
    return surface.material, look


def _triple(rgb: Sequence[float]) -> str:
    return "({:.3f}, {:.3f}, {:.3f})".format(*rgb)


def _slab(node: TreeNode, x: float, y: float, height: str) -> tuple[str, str]:
    """Return the name of the SDK function for a support's outline, and the source of the call."""
    if node.outline.shape == "rectangle":
        return "box", f"box(({x!r}, {y!r}, {height}))"
    if node.outline.shape == "round" and abs(x - y) < ROUND_WITHIN * x:
        return "cylinder", f"cylinder({round((x + y) / 4, 6)!r}, {height})"
    corners = [(round(a * x, 5), round(b * y, 5)) for a, b in node.outline.corners().tolist()]
    call = "prism" if node.outline.shape == "round" else "extrusion"
    return call, f"{call}({corners!r}, {height})"
