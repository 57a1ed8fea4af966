# Label: spoon
from neoworld_mjx.program.sdk import Object, box, ellipsoid

depth = 0.012  # 0.008 to 0.03 m
width = 0.036  # 0.025 to 0.08 m
height = 0.17  # 0.12 to 0.35 m
stuff = "steel"  # one of steel, pine, bamboo

spoon = Object("spoon", label="spoon")
body = spoon.part("body", material=stuff)
bowl = 0.3 * height
body.add(ellipsoid((depth / 2, width / 2, bowl / 2)), by="bottom")
body.add(box((0.4 * depth, 0.3 * width, height - 0.9 * bowl)), at=(0, 0, 0.9 * bowl), by="bottom")
