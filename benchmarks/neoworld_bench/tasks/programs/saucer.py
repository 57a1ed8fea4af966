# Label: plate
from neoworld_mjx.program.sdk import Object, cylinder, lathe

depth = 0.2  # 0.08 to 0.3 m
width = 0.2  # 0.08 to 0.3 m
height = 0.02  # 0.008 to 0.05 m
colour = "white"  # one of white, blue, wood

LOOK = {"white": (0.95, 0.95, 0.93), "blue": (0.5, 0.62, 0.75), "wood": (0.72, 0.55, 0.36)}
obj = Object("saucer", label="plate")
obj.material("glaze", like="ceramic", rgb=LOOK[colour])
plate = obj.part("plate", material="glaze")
r = depth / 2
plate.add(cylinder(0.62 * r, 0.005), by="bottom")
plate.add(lathe([(0.6 * r, 0), (r, height - 0.004)], 0.004, sectors=20), by="bottom")
