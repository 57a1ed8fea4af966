# Label: folding ruler
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion

depth = 0.03  # 0.025 to 0.035 m
width = 0.23  # 0.15 to 0.28 m
height = 0.022  # 0.016 to 0.034 m
links = 6  # 4 to 10
scale = "yellow"  # one of yellow, white, beech
ends = "round"  # one of round, square

TINT = {"yellow": (0.9, 0.75, 0.15), "white": (0.93, 0.93, 0.9), "beech": (0.8, 0.62, 0.4)}
obj = Object("folding_ruler", label="folding ruler")
wood = obj.material("lacquer", like="wood", rgb=TINT[scale])
R, half = depth / 2, width / 2
level = height / links
thick = level - 0.0003
if ends == "round":
    turn = [math.pi * (k / 8 - 0.5) for k in range(9)]
    outline = [(R * math.sin(-t), half - R + R * math.cos(t)) for t in turn]
    outline += [(-x, -y) for x, y in outline]
else:
    outline = [(R, half), (-R, half), (-R, -half), (R, -half)]

# Every link lies on the one below, and they turn about their two ends by turns.
below = None
for k in range(links):
    z = k * level
    link = obj.part(f"link_{k + 1}", material=wood)
    link.add(extrusion(outline, thick), at=(0, 0, z + thick / 2))
    for m in range(1, 11):
        y = half - R - m * (width - 2 * R) / 11
        tall = 0.4 * depth if m % 5 == 0 else 0.25 * depth
        mark = box((tall, 0.0012, 0.0002))
        ink = (0.75, 0.1, 0.1) if m == 5 else (0.1, 0.1, 0.1)
        link.add(mark, at=(R, y, z + thick), by="front", role="visual", rgb=ink)
    for end in (1, -1):
        disc = cylinder(0.38 * R, 0.0002)
        pin = (0, end * (half - R), z + thick)
        link.add(disc, at=pin, role="visual", material="brass")
    if below is not None:
        end = 1 if k % 2 else -1
        obj.revolute(
            f"fold_{k}", below, link, at=(0, end * (half - R), z), axis=(0, 0, end), range=(0, 3.14)
        )
    below = link
