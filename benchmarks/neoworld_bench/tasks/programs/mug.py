# Label: cup
from neoworld_mjx.program.sdk import Object, cylinder, tube

depth = 0.075  # 0.05 to 0.1 m
width = 0.075  # 0.05 to 0.1 m
height = 0.09  # 0.06 to 0.14 m
wall = 0.004  # 0.003 to 0.006 m
colour = "white"  # one of white, blue, green, clay

LOOK = {
    "white": (0.95, 0.95, 0.93),
    "blue": (0.3, 0.45, 0.7),
    "green": (0.45, 0.62, 0.45),
    "clay": (0.76, 0.45, 0.3),
}
obj = Object("mug", label="cup")
obj.material("clay", like="ceramic", rgb=LOOK[colour])
body = obj.part("body", material="clay")
body.add(cylinder(depth / 2, 0.006), by="bottom")
body.add(tube(depth / 2, wall, height - 0.0055, sectors=16), at=(0, 0, 0.0055), by="bottom")
