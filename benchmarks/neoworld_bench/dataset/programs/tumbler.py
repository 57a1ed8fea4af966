# Label: tumbler
from neoworld_mjx.program.sdk import Object, lathe

depth = 0.08  # 0.04 to 0.4 m
width = 0.08  # 0.04 to 0.4 m
height = 0.1  # 0.04 to 0.5 m
taper = 0.9  # 0.6 to 1.0
wall = 0.004  # 0.002 to 0.012 m
stuff = "ceramic"  # one of ceramic, steel, terracotta, glass, plastic

TONE = {
    "ceramic": (0.3, 0.45, 0.55),
    "steel": (0.72, 0.73, 0.75),
    "terracotta": (0.72, 0.4, 0.26),
    "glass": (0.8, 0.88, 0.9),
    "plastic": (0.85, 0.35, 0.2),
}
tumbler = Object("tumbler", label="tumbler")
like = "glass" if stuff == "glass" else stuff
look = {"alpha": 0.4} if stuff == "glass" else {}
glaze = tumbler.material("glaze", like=like, rgb=TONE[stuff], **look)
r = depth / 2
body = tumbler.part("body", material=glaze)
outer = [(0, 0), (taper * r, 0), (r, height)]
body.add(lathe(outer, thickness=wall, sectors=12, oval=width / depth))
