# Label: pencil
from neoworld_mjx.program.sdk import Object, frustum, prism, ring

depth = 0.008  # 0.006 to 0.03 m
width = 0.008  # 0.006 to 0.03 m
height = 0.17  # 0.08 to 0.4 m
colour = "yellow"  # one of yellow, red, blue, green, black, steel

TONE = {
    "yellow": (0.92, 0.7, 0.15),
    "red": (0.75, 0.15, 0.15),
    "blue": (0.15, 0.3, 0.65),
    "green": (0.15, 0.45, 0.3),
    "black": (0.12, 0.12, 0.13),
    "steel": (0.75, 0.76, 0.78),
}
pencil = Object("pencil", label="pencil")
paint = pencil.material("paint", like="wood", rgb=TONE[colour], pattern="plain")
body = pencil.part("body", material=paint)
r, tip = depth / 2, min(0.018, 0.12 * height)
# Six flat sides, so that it does not roll.
body.add(prism([(x, y) for x, y, _ in ring(6, r)], height - tip), by="bottom")
body.add(frustum(r, 0.0008, tip), at=(0, 0, height), by="top", rgb=(0.85, 0.68, 0.45))
