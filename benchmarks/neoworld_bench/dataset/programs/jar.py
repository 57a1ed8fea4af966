# Label: jar
from neoworld_mjx.program.sdk import Object, lathe

depth = 0.1  # 0.05 to 0.25 m
width = 0.1  # 0.05 to 0.25 m
height = 0.13  # 0.05 to 0.3 m
colour = "blue"  # one of blue, cream, green, brown

TONE = {
    "blue": (0.22, 0.36, 0.55),
    "cream": (0.88, 0.82, 0.68),
    "green": (0.35, 0.5, 0.38),
    "brown": (0.45, 0.28, 0.18),
}
jar = Object("jar", label="jar")
glaze = jar.material("glaze", like="ceramic", rgb=TONE[colour])
r = depth / 2
# A straight mouth of 0.8 of the width, in which a lid sits.
outer = [(0, 0), (0.8 * r, 0), (r, 0.3 * height), (r, 0.7 * height), (0.8 * r, 0.92 * height)]
outer.append((0.8 * r, height))
jar.part("body", material=glaze).add(lathe(outer, thickness=0.005, oval=width / depth))
