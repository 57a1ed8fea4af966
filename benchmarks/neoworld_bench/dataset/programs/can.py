# Label: tin can
from neoworld_mjx.program.sdk import Object, cylinder, tube

depth = 0.075  # 0.03 to 0.2 m
width = 0.075  # 0.03 to 0.2 m
height = 0.11  # 0.02 to 0.3 m
label = "red"  # one of red, green, blue, orange, plain

TONE = {
    "red": (0.75, 0.18, 0.15),
    "green": (0.2, 0.48, 0.28),
    "blue": (0.15, 0.35, 0.62),
    "orange": (0.9, 0.55, 0.15),
    "plain": (0.75, 0.76, 0.77),
}
can = Object("can", label="tin can")
tin = can.material("tin", like="water", friction=0.4, rgb=(0.75, 0.76, 0.78), alpha=1.0)
body = can.part("body", material=tin)
r = depth / 2
body.add(cylinder(r, height), by="bottom")
if label != "plain":
    band = tube(r + 0.0002, 0.001, 0.78 * height, sectors=24)
    body.add(band, at=(0, 0, height / 2), role="visual", rgb=TONE[label])
