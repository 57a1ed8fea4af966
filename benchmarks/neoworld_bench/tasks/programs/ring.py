# Label: ring
from neoworld_mjx.program.sdk import Object, tube

depth = 0.08  # 0.04 to 0.12 m
width = 0.08  # 0.04 to 0.12 m
height = 0.02  # 0.008 to 0.04 m
bore = 0.034  # 0.012 to 0.08 m
colour = "green"  # one of green, red, blue, yellow, steel

LOOK = {
    "green": (0.25, 0.6, 0.3),
    "red": (0.78, 0.2, 0.18),
    "blue": (0.2, 0.35, 0.72),
    "yellow": (0.92, 0.76, 0.2),
    "steel": (0.7, 0.71, 0.73),
}
obj = Object("ring", label="ring")
obj.material("paint", like="pine", rgb=LOOK[colour])
body = obj.part("ring", material="paint")
body.add(tube(depth / 2, (depth - bore) / 2, height, sectors=16), by="bottom")
