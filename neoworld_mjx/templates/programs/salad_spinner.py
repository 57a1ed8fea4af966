# Label: salad spinner
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, lathe, tube

depth = 0.23  # 0.2 to 0.25 m
width = 0.27  # 0.26 to 0.3 m
height = 0.21  # 0.18 to 0.26 m
ribs = 10  # 8 to 16
drive = "crank"  # one of crank, knob
ears = "loop"  # one of loop, tab
colour = "green"  # one of green, red, white, blue

TINT = {"green": (0.45, 0.65, 0.2), "red": (0.75, 0.2, 0.15), "blue": (0.2, 0.4, 0.65)}
R, WALL, LID, TOP = depth / 2, 0.003, 0.022, 0.035
rim = height - TOP - LID
obj = Object("salad_spinner", label="salad spinner")
tint = obj.material("tint", like="polypropylene", rgb=TINT.get(colour, (0.92, 0.92, 0.9)))
clear = obj.material("clear", like="acrylic", rgb=(0.8, 0.88, 0.88), alpha=0.45)
bowl = obj.part("bowl", material=clear)
side = [(0, 0), (0.6 * R, 0), (0.8 * R, 0.15 * rim), (0.97 * R, 0.7 * rim), (R, rim)]
bowl.add(lathe(side, thickness=WALL, sectors=16))
bowl.add(cylinder(0.008, 0.012), at=(0, 0, WALL - 0.001), by="bottom")
for way in (1, -1):
    edge = way * (R - 0.004)
    out = width / 2 - R + 0.004
    face = "right" if way > 0 else "left"
    if ears == "tab":
        bowl.add(
            box((0.07, out, 0.006)), at=(0, edge, rim - 0.018), by=f"{face}.top", material=tint
        )
    else:
        for px in (-0.035, 0.035):
            near = math.sqrt(R * R - px * px) - 0.006
            bar = box((0.01, width / 2 - near, 0.008))
            bowl.add(bar, at=(px, way * near, rim - 0.018), by=f"{face}.top", material=tint)
        grip = box((0.08, 0.009, 0.008))
        at = (0, way * width / 2, rim - 0.018)
        bowl.add(grip, at=at, by=f"{'left' if way > 0 else 'right'}.top", material=tint)

basket = obj.part("basket", material=tint)
r, base = 0.6 * R, WALL + 0.0125
basket.add(cylinder(r, 0.003), at=(0, 0, base), by="bottom")
basket.add(tube(0.93 * R, 0.003, 0.012), at=(0, 0, rim - 0.014), by="bottom")
for k in range(ribs):
    t = 2 * math.pi * k / ribs
    low, high = (r - 0.006, base + 0.001), (0.93 * R - 0.002, rim - 0.008)
    middle, rise = (low[0] + high[0]) / 2, (high[1] - low[1])
    lean = math.atan2(high[0] - low[0], rise)
    at = (middle * math.cos(t), middle * math.sin(t), (low[1] + high[1]) / 2)
    bar = box((0.003, 0.01, math.hypot(rise, high[0] - low[0])))
    basket.add(bar, at=at, rpy=(0, lean, t))

lid = obj.part("lid", material=tint)
plate = [(0, 0), (0.9 * R, 0), (R, 0.002), (R, 0.012), (0.6 * R, LID)]
lid.add(lathe(plate, thickness=0.004, sectors=16), at=(0, 0, rim + 0.0005))
lid.add(cylinder(0.6 * R, 0.003), at=(0, 0, rim + LID), by="top")
obj.prismatic("lid_lift", bowl, lid, axis="top", range=(0, 0.15), friction=3)
crank = obj.part("crank", material="polypropylene")
z = rim + LID + 0.001
if drive == "crank":
    reach = 0.5 * R
    crank.add(cylinder(0.018, 0.012), at=(0, 0, z), by="bottom")
    crank.add(box((reach, 0.018, 0.007)), at=(0, 0, z + 0.004), by="back.bottom")
    crank.add(cylinder(0.012, 0.009), at=(reach, 0, z + 0.003), by="bottom")
    knob = obj.part("knob", material=tint)
    top = z + 0.0125
    knob.add(lathe([(0, 0), (0.007, 0), (0.012, 0.6 * (height - top)), (0.009, height - top)]),
             at=(reach, 0, top))  # fmt: skip
    obj.continuous("knob_turn", crank, knob, at=(reach, 0, top), axis="top")
else:
    crank.add(cylinder(0.45 * R, 0.008), at=(0, 0, z), by="bottom")
    crank.add(box((0.8 * R, 0.016, height - z - 0.004)), at=(0, 0, height), by="top")
# The basket turns three times as fast as the crank.
spin = obj.continuous("spin", bowl, basket, at=(0, 0, 0), axis="top")
obj.continuous("crank_turn", lid, crank, at=(0, 0, z), axis="top", mimic=spin, multiplier=1 / 3)
