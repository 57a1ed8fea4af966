# Label: test tube
from neoworld_mjx.program.sdk import Object, lathe, tube

depth = 0.017  # 0.012 to 0.04 m
width = 0.017  # 0.012 to 0.04 m
height = 0.13  # 0.08 to 0.24 m
fill = "red"  # one of red, blue, yellow, green

TONE = {
    "red": (0.75, 0.2, 0.2),
    "blue": (0.2, 0.35, 0.75),
    "yellow": (0.9, 0.8, 0.25),
    "green": (0.3, 0.6, 0.35),
}
glass = Object("test_tube", label="test tube")
clear = glass.material("clear", like="glass", rgb=(0.82, 0.9, 0.92), alpha=0.45)
body = glass.part("body", material=clear)
r = depth / 2
shell = [(0, 0), (0.45 * r, 0.002), (0.78 * r, 0.3 * r + 0.002), (0.92 * r, r), (0.92 * r, height)]
body.add(lathe(shell, thickness=0.0015, sectors=10))
body.add(tube(r, 0.002, 0.004, sectors=10), at=(0, 0, height), by="top")
inner = [(0, 0), (0.6 * r, 0.5 * r), (0.74 * r, r), (0.74 * r, 0.45 * height)]
body.add(lathe(inner, sectors=10), at=(0, 0, 0.003), role="visual", rgb=TONE[fill])
