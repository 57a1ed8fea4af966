# Label: french press
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, difference, lathe, sphere, sweep, tube

depth = 0.16  # 0.14 to 0.18 m
width = 0.1  # 0.085 to 0.12 m
height = 0.24  # 0.19 to 0.3 m
bars = 4  # 3 to 6
handle = "loop"  # one of loop, open
metal = "steel"  # one of steel, brass, copper, black

LOOK = {"steel": (0.72, 0.73, 0.75), "brass": (0.75, 0.58, 0.28), "copper": (0.72, 0.42, 0.28)}
R, FOOT, KNOB, STRIP = width / 2, 0.008, 0.028, 0.003
rim = height - KNOB - 0.026
glass_r = R - STRIP
obj = Object("french_press", label="french press")
chrome = obj.material("chrome", like="steel", density=2700, rgb=LOOK.get(metal, (0.1, 0.1, 0.1)))
clear = obj.material("clear", like="glass", rgb=(0.82, 0.9, 0.9), alpha=0.35)
body = obj.part("body", material=chrome)
beaker = [(0, 0), (glass_r, 0), (glass_r, rim - FOOT)]
body.add(lathe(beaker, thickness=0.003, sectors=16), at=(0, 0, FOOT), material=clear)
for z in (FOOT + 0.004, rim - 0.03):
    body.add(tube(R, STRIP + 0.0005, 0.012), at=(0, 0, z), by="bottom")
for k in range(bars):
    # The first bar stands at the back; the handle is in front.
    t = math.pi + 2 * math.pi * (k - (bars - 1) / 2) / (bars + 0.5)
    at = ((R - STRIP / 2) * math.cos(t), (R - STRIP / 2) * math.sin(t), 0)
    body.add(box((STRIP, 0.01, rim - 0.02)), at=at, rpy=(0, 0, t), by="bottom")
front, out = R - 0.002, depth - R - 0.01
high, low = rim - 0.024, 0.25 * rim
path = [(front, 0, high), (out, 0, high + 0.006), (out, 0, (high + low) / 2), (out, 0, low)]
if handle == "loop":
    path += [(front, 0, FOOT + 0.01)]
body.add(sweep(path, width=0.018, thickness=0.012, smooth=3), material="abs")
body.add(box((0.01, 0.012, rim - 0.02)), at=(R - 0.004, 0, 0), by="back.bottom")

lid = obj.part("lid", material=chrome)
hole = cylinder(0.004, 0.1)
lid.add(difference(cylinder(R, 0.008), hole), at=(0, 0, rim + 0.0005), by="bottom")
lid.add(difference(cylinder(0.75 * R, 0.007), hole), at=(0, 0, rim + 0.008), by="bottom")
lid.add(difference(cylinder(0.45 * R, 0.006), hole), at=(0, 0, rim + 0.014), by="bottom")
skirt = tube(glass_r - 0.005, 0.002, 0.012)
lid.add(skirt, at=(0, 0, rim + 0.001), by="top")
obj.continuous("lid_turn", body, lid, at=(0, 0, rim), axis="top")

# Pressed down at rest; it is pulled up through the lid.
plunger = obj.part("plunger", material=chrome)
plunger.add(sphere(KNOB / 2), at=(0, 0, height), by="top", material="abs")
plunger.add(
    cylinder(0.0025, height - KNOB - FOOT - 0.004), at=(0, 0, height - KNOB + 0.004), by="top"
)
sieve = cylinder(glass_r - 0.005, 0.004)
plunger.add(sieve, at=(0, 0, FOOT + 0.008), by="bottom")
plunger.add(tube(glass_r - 0.004, 0.003, 0.008), at=(0, 0, FOOT + 0.006), by="bottom")
travel = rim - FOOT - 0.04
obj.prismatic("plunge", lid, plunger, axis="top", range=(0, travel), friction=2.5)
