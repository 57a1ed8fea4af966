"""How materials shine: metallic and roughness, by what a material is."""

from ..spec import Material

_METALS = {
    "steel": 0.35, "stainless_steel": 0.25, "cast_iron": 0.65, "iron": 0.5, "aluminium": 0.35,
    "brass": 0.3, "bronze": 0.35, "copper": 0.3, "silver": 0.2, "gold": 0.2, "chrome": 0.1,
    "metal": 0.35,
}  # fmt: skip
_OTHERS = {
    "glass": 0.05, "acrylic": 0.1, "pet": 0.15, "water": 0.02, "coffee": 0.05, "porcelain": 0.15,
    "ceramic": 0.25, "marble": 0.25, "plastic": 0.4, "abs": 0.4, "polypropylene": 0.4,
    "polyethylene": 0.45, "pvc": 0.4, "nylon": 0.45, "wax": 0.4, "electronics": 0.4,
    "wood": 0.6, "pine": 0.65, "oak": 0.6, "walnut": 0.55, "bamboo": 0.55, "plywood": 0.65,
    "mdf": 0.7, "chipboard": 0.6, "stone": 0.8, "concrete": 0.9, "brick": 0.9, "terracotta": 0.85,
    "cork": 0.9, "paper": 0.9, "cardboard": 0.9, "foam": 0.95, "upholstery": 0.95,
    "fabric": 0.95, "leather": 0.6, "rubber": 0.85, "silicone": 0.5, "soil": 0.95, "plant": 0.7,
    "bread": 0.85, "food": 0.6, "fruit": 0.4, "meat": 0.5, "cheese": 0.5, "chocolate": 0.4,
    "soap": 0.4, "insulated": 0.4,
}  # fmt: skip
UNKNOWN = 0.5
"""Roughness of a material whose name says nothing."""


def look(material: Material) -> tuple[float, float]:
    """Return how metallic a material is, and how rough, both from 0 to 1.

    Its name begins, or ends, with what it is made of: "steel", "steel_b0b0b0", "dark_oak". The
    longest name that fits decides.
    """
    words = material.name.lower()
    fits = [
        name
        for name in (*_METALS, *_OTHERS)
        if words == name or words.startswith(f"{name}_") or words.endswith(f"_{name}")
    ]
    if not fits:
        return 0.0, UNKNOWN
    name = max(fits, key=len)
    return (1.0, _METALS[name]) if name in _METALS else (0.0, _OTHERS[name])
