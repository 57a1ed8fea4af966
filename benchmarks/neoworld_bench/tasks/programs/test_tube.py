# Label: test tube
from neoworld_mjx.program.sdk import Object, cylinder, torus, tube

depth = 0.02  # 0.016 to 0.03 m
width = 0.02  # 0.016 to 0.03 m
height = 0.12  # 0.08 to 0.16 m
fill = "red"  # one of red, blue, yellow

FILLS = {"red": (0.8, 0.2, 0.2), "blue": (0.2, 0.4, 0.8), "yellow": (0.9, 0.8, 0.2)}
RIM = 0.0012
obj = Object("test_tube", label="test tube")
glass = obj.material("tube_glass", like="glass", alpha=0.45)
body = obj.part("body", material=glass)
r = depth / 2 - RIM
body.add(tube(r, 0.0012, height - 0.006), at=(0, 0, 0.006), by="bottom")
body.add(cylinder(r, 0.0065), by="bottom")
body.add(cylinder(0.8 * r, 0.3 * height), at=(0, 0, 0.006), by="bottom", rgb=FILLS[fill])
body.add(torus(r - 0.0004, RIM + 0.0004), at=(0, 0, height), by="top")
