"""Programs of the environment's supports, written from the parsed boxes without a model.

The paper uses static primitives, such as a slab for a floor, a counter or a wall. Here, the slab
has the support's outline, and freestanding tables have legs.

Named materials, and the finish of materials that a program defines.

Each named material has a density, a friction coefficient and a plain, typical color. The photo
overrides the color.

Densities are those of the bulk solid, rounded. Sources are the CRC Handbook of Chemistry and
Physics (metals, glass, stone, polymers), the USDA Wood Handbook FPL-GTR-282, table 5-3 (wood at
12 % moisture), and the FAO/INFOODS Density Database 2.0 (food). Friction coefficients are those of
dry sliding on a wooden or lacquered top, from the tables of the Engineering ToolBox, rounded to
0.05. The surface finish changes them by up to a third.

"insulated" describes the whole wall of an appliance: 39 mm of rigid polyurethane foam between two
steel sheets of 0.5 mm each, so the density is (2 * 0.5 * 7850 + 39 * 40) / 40 kg/m^3. Manufacturers
of such panels (Metecno, Hark) state 40 to 45 kg/m^3 for the foam and 0.3 to 0.8 mm for the sheets.
"""

from collections.abc import Sequence
from typing import Any

from shapely import Polygon

from ..errors import choices
from ..spec import Material, SurfacePattern, TreeNode
from ..spec.finish import finish, named_finish
from ..spec.room import PATTERN_KINDS, RGB
from . import session as validate

_BY_MATERIAL: dict[str, tuple[float, float, tuple[float, float, float]]] = {
    # name: density [kg/m^3], friction, color
    "wood": (650, 0.45, (0.60, 0.42, 0.26)),
    "pine": (450, 0.45, (0.80, 0.64, 0.42)),
    "oak": (720, 0.45, (0.62, 0.45, 0.28)),
    "walnut": (610, 0.45, (0.36, 0.24, 0.16)),
    "bamboo": (700, 0.40, (0.82, 0.70, 0.45)),
    "plywood": (600, 0.45, (0.78, 0.62, 0.42)),
    "mdf": (750, 0.40, (0.66, 0.52, 0.38)),
    "chipboard": (650, 0.40, (0.90, 0.89, 0.86)),
    "cork": (180, 0.60, (0.72, 0.55, 0.38)),
    "paper": (800, 0.40, (0.95, 0.94, 0.90)),
    "cardboard": (150, 0.45, (0.72, 0.56, 0.38)),
    "steel": (7850, 0.40, (0.62, 0.63, 0.65)),
    "stainless_steel": (7900, 0.35, (0.75, 0.76, 0.78)),
    "cast_iron": (7200, 0.45, (0.18, 0.18, 0.19)),
    "aluminium": (2700, 0.40, (0.78, 0.79, 0.81)),
    "brass": (8500, 0.40, (0.78, 0.62, 0.28)),
    "copper": (8960, 0.40, (0.72, 0.45, 0.30)),
    "silver": (10490, 0.35, (0.83, 0.83, 0.82)),
    "gold": (19300, 0.40, (0.86, 0.70, 0.30)),
    "glass": (2500, 0.35, (0.80, 0.88, 0.88)),
    "ceramic": (2400, 0.40, (0.92, 0.91, 0.88)),
    "porcelain": (2400, 0.35, (0.96, 0.96, 0.95)),
    "terracotta": (1900, 0.55, (0.76, 0.42, 0.28)),
    "stone": (2700, 0.55, (0.55, 0.54, 0.52)),
    "marble": (2700, 0.40, (0.93, 0.92, 0.90)),
    "concrete": (2300, 0.60, (0.62, 0.61, 0.59)),
    "brick": (1900, 0.60, (0.65, 0.33, 0.25)),
    "insulated": (240, 0.40, (0.85, 0.86, 0.87)),
    "plastic": (1050, 0.35, (0.85, 0.85, 0.85)),
    "abs": (1050, 0.35, (0.20, 0.20, 0.22)),
    "polypropylene": (905, 0.30, (0.92, 0.92, 0.90)),
    "polyethylene": (950, 0.25, (0.90, 0.92, 0.94)),
    "pvc": (1390, 0.40, (0.86, 0.86, 0.84)),
    "pet": (1380, 0.30, (0.80, 0.88, 0.90)),
    "acrylic": (1180, 0.40, (0.85, 0.90, 0.92)),
    "nylon": (1140, 0.30, (0.90, 0.89, 0.84)),
    "foam": (30, 0.55, (0.94, 0.94, 0.92)),
    "upholstery": (60, 0.60, (0.50, 0.48, 0.46)),
    "rubber": (1100, 0.80, (0.14, 0.14, 0.14)),
    "silicone": (1150, 0.70, (0.70, 0.72, 0.74)),
    "leather": (860, 0.55, (0.38, 0.24, 0.16)),
    "fabric": (300, 0.55, (0.60, 0.58, 0.55)),
    "wax": (900, 0.35, (0.94, 0.90, 0.78)),
    "soap": (1020, 0.30, (0.94, 0.90, 0.84)),
    "electronics": (1300, 0.40, (0.15, 0.15, 0.16)),
    "plant": (700, 0.50, (0.28, 0.48, 0.22)),
    "soil": (1300, 0.60, (0.28, 0.20, 0.14)),
    "water": (1000, 0.10, (0.70, 0.80, 0.86)),
    "coffee": (1000, 0.10, (0.25, 0.14, 0.08)),
    "food": (1000, 0.45, (0.80, 0.62, 0.40)),
    "fruit": (850, 0.45, (0.78, 0.22, 0.16)),
    "bread": (270, 0.50, (0.78, 0.56, 0.32)),
    "meat": (1050, 0.45, (0.62, 0.30, 0.26)),
    "cheese": (1080, 0.45, (0.94, 0.80, 0.42)),
    "chocolate": (1300, 0.40, (0.30, 0.18, 0.12)),
}

_ALPHA = {"glass": 0.3, "acrylic": 0.35, "pet": 0.35, "water": 0.45}
"""Opacity of each transparent material, from 0 to 1; all other materials are opaque."""

MATERIALS: dict[str, Material] = {
    name: Material(
        name=name, density=density, friction=friction, rgba=(*rgb, _ALPHA.get(name, 1.0))
    )
    for name, (density, friction, rgb) in _BY_MATERIAL.items()
}
"""Named materials that a program may use without defining them."""


def stated_finish(
    kind: Any, rgb2: Any, step: Any, along: Any, metallic: Any, roughness: Any, context: str
) -> dict[str, Any]:
    """Validate the finish arguments of a material that are not None, and return the fields."""
    fields: dict[str, Any] = {
        key: validate.number(share, f"{context}: {key}")
        for key, share in (("metallic", metallic), ("roughness", roughness))
        if share is not None
    }
    if kind is None:
        if rgb2 is not None or step is not None:
            raise ValueError(f"{context}: rgb2 and step need a pattern=, as its name has none")
        return fields
    if kind not in PATTERN_KINDS:
        raise ValueError(f"{context}: pattern: {choices(str(kind), list(PATTERN_KINDS))}")
    fields["pattern"] = validate.build_spec(
        SurfacePattern,
        f"{context}: pattern",
        kind=kind,
        rgb=None if rgb2 is None else validate.colour(rgb2, f"{context}: rgb2"),
        step=None if step is None else validate.length(step, f"{context}: step"),
        along=along,
    )
    return fields


def inherited_finish(base: Material, name: str) -> dict[str, Any]:
    """Return the finish fields that the material `name` inherits from `base`.

    A finish is inherited only if the name of `base` implies a finish and `name` does not. For
    example, "seat" inherits the finish of "oak", but "steel_seat" does not.
    """
    if named_finish(name) or not named_finish(base.name):
        return {}
    return {k: v for k, v in finish(base)._asdict().items() if v not in (None, 0.0)}


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
body.add(cylinder(LEG, Z - BOARD), at={foot!r}, by="bottom", name="pedestal")
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
    if legged:
        call, slab = _slab(node, x, y, "BOARD")
        calls = ", ".join(sorted({call, "cylinder"}))
        inside = Polygon(node.outline.corners() * [x, y]).representative_point()
        foot = (round(inside.x, 4), round(inside.y, 4), 0)
        numbers = {"z": z, "board": BOARD_M, "leg": LEG_M}
        return _OUTLINED_TABLE.format(**common, **numbers, calls=calls, slab=slab, foot=foot)
    call, slab = _slab(node, x, y, repr(z))
    return _SLAB.format(**common, call=call, slab=slab)


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
