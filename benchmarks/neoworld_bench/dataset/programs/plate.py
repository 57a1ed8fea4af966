# Label: plate
from neoworld_mjx.program.sdk import Object, lathe

depth = 0.24  # 0.1 to 0.4 m
width = 0.24  # 0.1 to 0.4 m
height = 0.022  # 0.012 to 0.05 m
colour = "white"  # one of white, blue, grey, yellow

TONE = {
    "white": (0.94, 0.93, 0.9),
    "blue": (0.35, 0.5, 0.68),
    "grey": (0.45, 0.46, 0.48),
    "yellow": (0.9, 0.78, 0.4),
}
plate = Object("plate", label="plate")
glaze = plate.material("glaze", like="porcelain", rgb=TONE[colour])
r = depth / 2
outer = [(0, 0), (0.62 * r, 0), (r, height - 0.0045)]
plate.part("body", material=glaze).add(lathe(outer, thickness=0.005, oval=width / depth))
