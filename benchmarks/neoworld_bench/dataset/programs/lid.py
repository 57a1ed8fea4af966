# Label: lid
from neoworld_mjx.program.sdk import Object, lathe

depth = 0.09  # 0.04 to 0.35 m
width = 0.09  # 0.04 to 0.35 m
height = 0.035  # 0.015 to 0.09 m
plug = 0.75  # 0.5 to 0.95
colour = "blue"  # one of blue, cream, green, brown, steel

TONE = {
    "blue": (0.2, 0.33, 0.52),
    "cream": (0.88, 0.82, 0.68),
    "green": (0.32, 0.47, 0.36),
    "brown": (0.42, 0.26, 0.17),
    "steel": (0.74, 0.75, 0.77),
}
lid = Object("lid", label="lid")
glaze = lid.material("glaze", like="ceramic", rgb=TONE[colour])
r, h = depth / 2, height
# A plug below a rim, and a knob.
outer = [(0, 0), (plug * r, 0), (plug * r, 0.25 * h), (r, 0.25 * h), (r, 0.4 * h)]
outer += [(0.3 * r, 0.55 * h), (0.2 * r, 0.7 * h), (0.3 * r, h)]
lid.part("body", material=glaze).add(lathe(outer, oval=width / depth))
