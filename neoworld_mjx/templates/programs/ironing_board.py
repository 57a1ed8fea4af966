# Label: ironing board
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion, sweep

depth = 1.3  # 1.1 to 1.5 m
width = 0.36  # 0.3 to 0.45 m
height = 0.85  # 0.75 to 0.95 m
nose = "round"  # one of round, straight
rest = "wire"  # one of wire, plate
cover = "blue"  # one of blue, grey, red, beige

TINT = {"blue": (0.35, 0.5, 0.7), "grey": (0.6, 0.62, 0.65), "red": (0.7, 0.25, 0.25)}
obj = Object("ironing_board", label="ironing board")
cloth = obj.material("cover", like="fabric", rgb=TINT.get(cover, (0.82, 0.76, 0.64)))
tube_steel = obj.material("tube", like="aluminium", density=1800, rgb=(0.82, 0.83, 0.85))
back, front, half = -depth / 2, depth / 2, width / 2
REST, TOP = 0.16, 0.03
tail = back + REST
board = obj.part("board", material=cloth)
flank = front - 0.32 * depth
if nose == "round":
    arc = [(math.pi / 2) * (1 - k / 6) for k in range(13)]
    tip = [(flank + (front - flank) * math.cos(t), half * math.sin(t)) for t in arc]
else:
    tip = [(flank, half), (front, 0.3 * half), (front, -0.3 * half), (flank, -half)]
outline = [(tail, -half), *tip[::-1], (tail, half)]
board.add(extrusion(outline, TOP), at=(0, 0, height - TOP / 2))
under = height - TOP
for y in (-0.3 * half, 0.3 * half):
    keel = box((0.75 * (front - tail), 0.015, 0.03))
    board.add(keel, at=(tail + 0.05, y, under + 0.001), by="back.top", material=tube_steel)

# Two frames cross below the board; spread, each rests against its stop.
span, wide = 0.36 * depth, half - 0.01
hang = under - 0.018
for side, name, y in ((1, "front", 0.16), (-1, "rear", 0.24)):
    leg = obj.part(f"{name}_legs", material=tube_steel)
    head, foot = -side * 0.5 * span + 0.06, side * span + 0.06
    reach = half * 2 * y
    across = (math.pi / 2, 0, 0)
    leg.add(cylinder(0.01, 2 * reach + 0.02), at=(head, 0, hang - 0.0225), rpy=across)
    for off in (-reach, reach):
        leg.add(sweep([(head, off, hang - 0.0225), (foot, off, 0.013)], radius=0.0095))
    leg.add(cylinder(0.011, 2 * wide - 0.04), at=(foot, 0, 0.0135), rpy=across)
    for off in (-wide + 0.015, wide - 0.015):
        leg.add(cylinder(0.0135, 0.03), at=(foot, off, 0.0135), rpy=across, material="rubber")
    lean = math.atan2(abs(foot - head), hang)
    pivot = (head, 0, hang - 0.0225)
    obj.revolute(
        f"{name}_fold", board, leg, at=pivot, axis=(0, side, 0), range=(0, 0.5), friction=3
    )
holder = obj.part("iron_rest", material=tube_steel)
z = height - 0.014
if rest == "wire":
    loop = [
        (tail + 0.0, -0.7 * half, z),
        (back + 0.006, -0.7 * half, z),
        (back + 0.006, 0.7 * half, z),
        (tail + 0.0, 0.7 * half, z),
    ]
    holder.add(sweep([(px - 0.001, py, pz) for px, py, pz in loop], radius=0.005))
    for k in range(3):
        y = (k - 1) * 0.35 * half
        holder.add(sweep([(tail - 0.001, y, z), (back + 0.006, y, z)], radius=0.003))
    holder.add(cylinder(0.005, 1.4 * half), at=(tail - 0.0065, 0, z), rpy=(math.pi / 2, 0, 0))
else:
    holder.add(box((REST - 0.001, 1.4 * half, 0.01)), at=(back, 0, z), by="back")
    holder.add(
        box((REST - 0.03, 1.2 * half, 0.003)),
        at=(back + 0.015, 0, z + 0.005),
        by="back.bottom",
        material="silicone",
    )
hinge = (tail - 0.001, 0, z - 0.005)
obj.revolute("rest_fold", board, holder, at=hinge, axis=(0, -1, 0), range=(0, 1.4), friction=1.5)
