"""Finish of materials: metallic value, roughness and pattern, given or derived from the name."""

from functools import lru_cache
from typing import NamedTuple

from .object import Material
from .room import PatternKind, SurfacePattern

_METALS = {
    "steel": 0.35, "stainless_steel": 0.25, "cast_iron": 0.65, "iron": 0.5, "aluminium": 0.35,
    "aluminum": 0.35, "brass": 0.3, "bronze": 0.35, "copper": 0.3, "silver": 0.2, "gold": 0.2,
    "chrome": 0.1, "tin": 0.35, "metal": 0.35,
}  # fmt: skip
_OTHERS = {
    "glass": 0.05, "acrylic": 0.1, "pet": 0.15, "water": 0.02, "coffee": 0.05, "porcelain": 0.15,
    "china": 0.15, "glaze": 0.15, "enamel": 0.15, "lacquer": 0.15,
    "ceramic": 0.25, "marble": 0.25, "plastic": 0.4, "abs": 0.4, "polypropylene": 0.4,
    "polyethylene": 0.45, "pvc": 0.4, "nylon": 0.45, "wax": 0.4, "electronics": 0.4,
    "wood": 0.6, "pine": 0.65, "oak": 0.6, "walnut": 0.55, "bamboo": 0.55, "birch": 0.6,
    "beech": 0.6, "maple": 0.6, "teak": 0.6, "cherry": 0.55, "plywood": 0.65,
    "mdf": 0.7, "chipboard": 0.6, "stone": 0.8, "concrete": 0.9, "brick": 0.9, "terracotta": 0.85,
    "cork": 0.9, "paper": 0.9, "cardboard": 0.9, "foam": 0.95, "upholstery": 0.95,
    "fabric": 0.95, "cloth": 0.95, "felt": 0.95, "leather": 0.6, "rubber": 0.85, "silicone": 0.5,
    "soil": 0.95, "plant": 0.7, "bread": 0.85, "food": 0.6, "fruit": 0.4, "meat": 0.5,
    "cheese": 0.5, "chocolate": 0.4, "soap": 0.4, "insulated": 0.4,
}  # fmt: skip
_PATTERNS: dict[str, PatternKind] = {
    **dict.fromkeys(
        ("wood", "pine", "oak", "walnut", "bamboo", "birch", "beech", "maple", "teak", "cherry",
         "plywood"), "grain",
    ),
    "stone": "speckles", "marble": "veins", "brick": "bricks",
    "fabric": "weave", "cloth": "weave", "upholstery": "weave", "stainless_steel": "brushed",
}  # fmt: skip
UNKNOWN_ROUGHNESS = 0.5
"""Roughness of a material with an unknown name."""
_MIN_AFFIX = 4
"""Smallest length of a substance that may be the start or end of a word, as in hardwood."""


class Finish(NamedTuple):
    """Appearance of a surface, apart from color and opacity."""

    metallic: float
    """Metallic value from 0 to 1."""
    roughness: float
    """Roughness from 0 to 1."""
    pattern: SurfacePattern | None
    """Pattern; None if the surface is plain."""


def finish(material: Material) -> Finish:
    """Return the finish of a material; values that are not given are derived from its name.

    The words of a name, separated by "_", identify the substance, as in "steel_b0b0b0" and
    "dark_oak". If several substances match, the longest one applies.
    """
    substance = _substance(material.name.lower())
    metallic, roughness = 0.0, UNKNOWN_ROUGHNESS
    if substance in _METALS:
        metallic, roughness = 1.0, _METALS[substance]
    elif substance is not None:
        roughness = _OTHERS[substance]
    pattern = material.pattern
    if pattern is None and substance in _PATTERNS:
        pattern = SurfacePattern(kind=_PATTERNS[substance])
    return Finish(
        metallic if material.metallic is None else material.metallic,
        roughness if material.roughness is None else material.roughness,
        None if pattern is None or pattern.kind == "plain" or material.photo else pattern,
    )


def named_finish(name: str) -> bool:
    """Return whether a material's name identifies a substance."""
    return _substance(name.lower()) is not None


@lru_cache(maxsize=1024)
def _substance(words: str) -> str | None:
    split, framed = words.split("_"), f"_{words}_"
    fits = [
        name
        for name in (*_METALS, *_OTHERS)
        if f"_{name}_" in framed
        or (
            len(name) >= _MIN_AFFIX
            and any(word.startswith(name) or word.endswith(name) for word in split)
        )
    ]
    return max(fits, key=len, default=None)
