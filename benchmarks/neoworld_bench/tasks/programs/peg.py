# Label: peg
from math import cos, pi, sin

from neoworld_mjx.program.sdk import Object, box, cylinder, prism

depth = 0.03  # 0.012 to 0.05 m
width = 0.03  # 0.012 to 0.05 m
height = 0.1  # 0.05 to 0.2 m
form = "round"  # one of round, square, faceted
colour = "yellow"  # one of yellow, red, blue, steel

LOOK = {
    "yellow": (0.92, 0.76, 0.2),
    "red": (0.78, 0.2, 0.18),
    "blue": (0.2, 0.35, 0.72),
    "steel": (0.7, 0.71, 0.73),
}
obj = Object("peg", label="peg")
obj.material("paint", like="oak", rgb=LOOK[colour])
peg = obj.part("peg", material="paint")
if form == "round":
    peg.add(cylinder(depth / 2, height), by="bottom")
elif form == "square":
    peg.add(box((depth, width, height)), by="bottom")
else:
    # Twelve flat sides, two of them along x and y each, so that it does not roll.
    corners = [pi / 12 + k * pi / 6 for k in range(12)]
    peg.add(prism([(depth / 2 * cos(a), width / 2 * sin(a)) for a in corners], height), by="bottom")
