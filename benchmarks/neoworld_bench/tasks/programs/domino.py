# Label: domino
from neoworld_mjx.program.sdk import Object, box

depth = 0.012  # 0.008 to 0.02 m
width = 0.04  # 0.02 to 0.06 m
height = 0.08  # 0.04 to 0.12 m
colour = "ivory"  # one of ivory, black, red, blue, green

LOOK = {
    "ivory": (0.93, 0.9, 0.8),
    "black": (0.15, 0.15, 0.16),
    "red": (0.75, 0.15, 0.15),
    "blue": (0.15, 0.3, 0.7),
    "green": (0.2, 0.55, 0.3),
}
obj = Object("domino", label="domino")
obj.material("tile", like="oak", rgb=LOOK[colour])
obj.part("tile", material="tile").add(box((depth, width, height)), by="bottom")
