# Label: bottle
from neoworld_mjx.program.sdk import Object, cylinder, frustum

depth = 0.06  # 0.04 to 0.08 m
width = 0.06  # 0.04 to 0.08 m
height = 0.2  # 0.12 to 0.28 m
colour = "green"  # one of green, brown, clear

LOOK = {"green": (0.2, 0.45, 0.28), "brown": (0.4, 0.24, 0.12), "clear": (0.8, 0.88, 0.9)}
obj = Object("bottle_plain", label="bottle")
obj.material("fill", like="pet", density=900, rgb=LOOK[colour], alpha=1.0)
bottle = obj.part("bottle", material="fill")
r = depth / 2
bottle.add(cylinder(r, 0.6 * height), by="bottom")
bottle.add(frustum(r, 0.4 * r, 0.2 * height), at=(0, 0, 0.599 * height), by="bottom")
bottle.add(cylinder(0.4 * r, 0.202 * height), at=(0, 0, height), by="top")
