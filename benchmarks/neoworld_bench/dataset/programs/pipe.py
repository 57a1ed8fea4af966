# Label: pipe
import math

from neoworld_mjx.program.sdk import Object, tube

depth = 0.05  # 0.02 to 0.3 m
width = 0.3  # 0.05 to 1.0 m
height = 0.05  # 0.02 to 0.3 m
wall = 0.004  # 0.002 to 0.04 m
stuff = "copper"  # one of copper, pvc, steel, cardboard, fabric

TONE = {"pvc": (0.55, 0.57, 0.6), "fabric": (0.85, 0.82, 0.78)}
pipe = Object("pipe", label="pipe")
skin = pipe.material("skin", like=stuff, **({"rgb": TONE[stuff]} if stuff in TONE else {}))
body = pipe.part("body", material=skin)
body.add(tube(depth / 2, wall, width, sectors=16), at=(0, 0, height / 2), rpy=(math.pi / 2, 0, 0))
