# Label: bowl
from neoworld_mjx.program.sdk import Object, lathe

depth = 0.2  # 0.08 to 0.4 m
width = 0.2  # 0.08 to 0.4 m
height = 0.08  # 0.02 to 0.16 m
foot = 0.45  # 0.1 to 0.8
colour = "white"  # one of white, blue, green, terracotta, steel

TONE = {
    "white": (0.93, 0.92, 0.88),
    "blue": (0.3, 0.45, 0.62),
    "green": (0.4, 0.55, 0.42),
    "terracotta": (0.72, 0.4, 0.26),
    "steel": (0.74, 0.75, 0.77),
}
bowl = Object("bowl", label="bowl")
glaze = bowl.material("glaze", like="ceramic", rgb=TONE[colour])
r = depth / 2
outer = [(0, 0), (foot * r, 0), ((foot + 0.75 * (1 - foot)) * r, 0.4 * height), (r, height)]
bowl.part("body", material=glaze).add(lathe(outer, thickness=0.004, oval=width / depth))
