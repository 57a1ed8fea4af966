"""Programs for supports of the environment, written from their parsed boxes without asking a model.

The paper takes them as static primitives: a slab for a floor, a counter or a wall. Only tables that
stand free get legs.
"""

from ..spec import TreeNode

LEGGED = ("table", "desk", "bench", "stool")
LEAST_LEGGED_M = 0.25
BOARD_M, LEG_M = 0.04, 0.06
_MATERIALS = {
    "glass": "glass",
    "marble": "marble",
    "granite": "stone",
    "stone": "stone",
    "concrete": "concrete",
    "tile": "ceramic",
    "metal": "steel",
    "steel": "steel",
    "carpet": "fabric",
    "cloth": "fabric",
    "plastic": "plastic",
    "wall": "concrete",
}

_SLAB = """from neoworld_mjx.program.sdk import Object, box

support = Object("{name}")
surface = support.material("{like}_surface", like="{like}"{rgb})
body = support.part("body", material=surface)
body.add(box(({x!r}, {y!r}, {z!r})), by="bottom", name="slab")
"""
_TABLE = """from neoworld_mjx.program.sdk import Object, box

X, Y, Z = {x!r}, {y!r}, {z!r}
BOARD, LEG = {board!r}, {leg!r}

support = Object("{name}")
surface = support.material("{like}_surface", like="{like}"{rgb})
body = support.part("body", material=surface)
body.add(box((X, Y, BOARD)), at=(0, 0, Z), by="top", name="board")
for i, sx in enumerate((-1, 1)):
    for j, sy in enumerate((-1, 1)):
        foot = (sx * (X - LEG) / 2, sy * (Y - LEG) / 2, 0)
        body.add(box((LEG, LEG, Z - BOARD)), at=foot, by="bottom", name=f"leg_{{i}}{{j}}")
"""


def support_program(node: TreeNode, rgb: tuple[float, float, float] | None = None) -> str:
    """Write the program of a support that fills its parsed box.

    Args:
        node: the support.
        rgb: its colour in 0 to 1, as the photo shows it; the material's own by default.
    """
    x, y, z = (round(v, 6) for v in node.box3d.size)
    words = f"{node.label} {node.description}".lower()
    like = next((name for word, name in _MATERIALS.items() if word in words), "wood")
    shade = "" if rgb is None else ", rgb=({:.3f}, {:.3f}, {:.3f})".format(*rgb)
    label = node.label.lower()
    legged = z >= LEAST_LEGGED_M and any(word in label for word in LEGGED)
    template = _TABLE if legged and min(x, y) > 4 * LEG_M else _SLAB
    return template.format(
        name=node.name, like=like, rgb=shade, x=x, y=y, z=z, board=BOARD_M, leg=LEG_M
    )
