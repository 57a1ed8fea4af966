# Label: domino
from neoworld_mjx.program.sdk import Object, box, sphere

depth = 0.012  # 0.008 to 0.03 m
width = 0.03  # 0.02 to 0.08 m
height = 0.06  # 0.04 to 0.16 m
pips = 3  # 1 to 6
colour = "black"  # one of black, ivory, red

TONE = {"black": (0.1, 0.1, 0.11), "ivory": (0.93, 0.9, 0.8), "red": (0.65, 0.12, 0.12)}
domino = Object("domino", label="domino")
resin = domino.material("resin", like="plastic", friction=0.5, rgb=TONE[colour])
body = domino.part("body", material=resin)
body.add(box((depth, width, height)), by="bottom")
ink = (0.1, 0.1, 0.1) if colour == "ivory" else (0.95, 0.95, 0.93)
for x in (-depth / 2, depth / 2):
    face = 0.0002 if x > 0 else -0.0002
    line = box((0.0006, 0.8 * width, 0.03 * height))
    body.add(line, at=(x - face, 0, height / 2), role="visual", rgb=ink)
    for k in range(pips):
        y = (k % 2 - 0.5) * 0.45 * width if pips > 1 else 0.0
        z = height * (0.6 + 0.14 * (k // 2))
        body.add(sphere(0.06 * width), at=(x - 4 * face, y, z), role="visual", rgb=ink)
