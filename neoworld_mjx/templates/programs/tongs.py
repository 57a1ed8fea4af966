# Label: kitchen tongs
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, difference, sweep, torus

depth = 0.28  # 0.2 to 0.38 m
width = 0.045  # 0.036 to 0.06 m
height = 0.03  # 0.026 to 0.04 m
heads = "scallop"  # one of scallop, flat, claw
grips = "rubber"  # one of rubber, none
teeth = 5  # 3 to 7

# They lie on their side: the hinge stands upright at the back, both arms reach forward.
obj = Object("tongs", label="kitchen tongs")
steel = obj.material("brushed", like="stainless_steel", density=5000)
soft = obj.material("grip", like="silicone", rgb=(0.12, 0.12, 0.13))
SHEET, half = 0.002, width / 2
back, front = -depth / 2 + 0.012, depth / 2
hinge = (back + 0.01, 0.0, height / 2)
first = obj.part("right_arm", material=steel)
second = obj.part("left_arm", material=steel)
fold = [0.22, 0.92] if heads == "claw" else [0.3, 0.85]
for side, arm in ((-1, first), (1, second)):
    near, reach = side * 0.0095, side * (half - 0.0045)
    path = [(hinge[0], near), (back + fold[0] * depth, reach), (back + 0.7 * depth, side * 0.011)]
    end = front - 0.055
    path.append((end, side * 0.008))
    points = [(x, y, height / 2) for x, y in path]
    arm.add(sweep(points, width=0.55 * height, thickness=SHEET))
    if grips == "rubber":
        (ax, ay), (bx, by) = path[0], path[1]
        turn = math.atan2(by - ay, bx - ax)
        pad = box((0.6 * (bx - ax), 0.005, 0.6 * height))
        at = (ax + 0.62 * (bx - ax), ay + 0.62 * (by - ay) + side * 0.002, height / 2)
        arm.add(pad, at=at, rpy=(0, 0, turn), material=soft)
    if heads == "flat":
        blade = box((0.06, SHEET, height))
        arm.add(blade, at=(front, side * 0.008, 0), by="front.bottom")
    elif heads == "claw":
        for z in (0.2, 0.8):
            prong = [
                (end - 0.01, side * 0.008, height / 2),
                (end + 0.02, side * 0.014, z * height),
                (front - 0.006, side * 0.012, z * height),
                (front - 0.002, side * 0.003, z * height),
            ]
            arm.add(sweep(prong, width=0.006, thickness=SHEET))
        arm.add(box((0.012, SHEET, height)), at=(end + 0.014, side * 0.0125, 0), by="bottom")
    else:
        cup = [(end - 0.004, side * 0.008), (end + 0.02, side * (half - 0.002)),
               (front - 0.015, side * (half - 0.002)), (front - 0.003, side * 0.005)]  # fmt: skip
        arm.add(sweep([(x, y, height / 2) for x, y in cup], width=height, thickness=SHEET))
        for k in range(teeth):
            z = (k + 0.5) * height / teeth
            tooth = box((0.004, 0.004, 0.6 * height / teeth))
            arm.add(tooth, at=(front - 0.004, side * 0.0042, z))
    # Lugs of the two arms lie above each other on the pin.
    for z in (0.28, 0.72):
        level = (z + (0.09 if side > 0 else -0.09)) * height
        hole = cylinder(0.0036, 0.1).moved((0, -side * 0.004, 0))
        lug = difference(box((0.012, 0.015, 0.14 * height)), hole)
        arm.add(lug, at=(hinge[0], side * 0.004, level))
pin = cylinder(0.003, 0.76 * height)
first.add(pin, at=hinge)
obj.revolute(
    "open", first, second, at=hinge, axis=(0, 0, 1), range=(0, 0.5), opens="left", friction=0.02
)
tab = obj.part("lock", material=steel)
ring = torus(0.005, 0.0015)
tab.add(ring, at=(-depth / 2, 0, height / 2), rpy=(math.pi / 2, 0, 0), by="back")
tab.add(box((0.008, 0.004, 0.1 * height)), at=(-depth / 2 + 0.0075, 0, height / 2), by="back")
obj.prismatic("lock_slide", first, tab, axis="back", range=(0, 0.012))
