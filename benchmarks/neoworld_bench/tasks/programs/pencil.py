# Label: pencil
from neoworld_mjx.program.sdk import Object, cylinder, frustum

depth = 0.01  # 0.007 to 0.016 m
width = 0.01  # 0.007 to 0.016 m
height = 0.17  # 0.1 to 0.2 m
colour = "yellow"  # one of yellow, red, green

LOOK = {"yellow": (0.9, 0.72, 0.15), "red": (0.75, 0.18, 0.16), "green": (0.2, 0.5, 0.3)}
obj = Object("pencil", label="pencil")
obj.material("paint", like="pine", density=900, rgb=LOOK[colour])
pencil = obj.part("pencil", material="paint")
r = depth / 2
pencil.add(frustum(0.3 * r, r, 0.015), by="bottom", rgb=(0.85, 0.7, 0.5))
pencil.add(cylinder(r, height - 0.0149), at=(0, 0, 0.0149), by="bottom")
