# Label: toy robot arm
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, rounded_box

depth = 0.34  # 0.28 to 0.42 m
width = 0.15  # 0.12 to 0.2 m
height = 0.3  # 0.26 to 0.38 m
base_shape = "box"  # one of box, round
gripper = "fingers"  # one of fingers, suction
colour = "orange"  # one of orange, blue, yellow, white

PAINT = {"orange": (0.92, 0.45, 0.1), "blue": (0.15, 0.35, 0.7), "yellow": (0.92, 0.78, 0.15)}
obj = Object("robot_arm_toy", label="toy robot arm")
paint = obj.material("paint", like="abs", rgb=PAINT.get(colour, (0.92, 0.92, 0.9)))
dark = obj.material("dark", like="abs", rgb=(0.13, 0.13, 0.14))
across = (math.pi / 2, 0, 0)
B, x0 = 0.16 * height, -depth / 2 + width / 2
base = obj.part("base", material=dark, mass=1.5)
if base_shape == "box":
    base.add(rounded_box((width, width, B), 0.006), at=(x0, 0, 0), by="bottom")
else:
    base.add(cylinder(width / 2, B), at=(x0, 0, 0), by="bottom")
base.add(
    box((0.002, 0.3 * width, 0.4 * B)),
    at=(x0 + width / 2, 0, B / 2),
    by="front",
    role="visual",
    rgb=(0.8, 0.1, 0.1),
)
turret = obj.part("turret", material=paint)
turret.add(cylinder(0.36 * width, 0.1 * height), at=(x0, 0, B + 0.0005), by="bottom")
shoulder = (x0, 0, B + 0.2 * height)
cheek = 0.14 * width
for y in (-cheek - 0.006, cheek + 0.006):
    turret.add(box((0.36 * width, 0.01, 0.16 * height)), at=(x0, y, B + 0.08 * height), by="bottom")
obj.continuous("turn", base, turret, at=(x0, 0, B), axis="top")

# Each link lies between the two plates of the one before, or has the next between its own.
upper = obj.part("upper_arm", material=paint)
elbow = (x0, 0, height - 0.075 * height)
hub = 0.065 * height
upper.add(cylinder(hub, 2 * cheek), at=shoulder, rpy=across)
for y in (-cheek + 0.005, cheek - 0.005):
    plate = box((0.1 * height, 0.0095, elbow[2] - shoulder[2]))
    upper.add(plate, at=(x0, y, shoulder[2]), by="bottom")
    upper.add(cylinder(0.075 * height, 0.0095), at=(x0, y, elbow[2]), rpy=across)
obj.revolute("shoulder", turret, upper, at=shoulder, axis="left", range=(-0.6, 0.45), friction=0.8)
fore = obj.part("forearm", material=paint)
wide = 2 * (cheek - 0.011)
wrist_x = x0 + 0.52 * (depth / 2 - x0)
fore.add(cylinder(0.06 * height, wide), at=elbow, rpy=across)
reach = wrist_x - x0
fore.add(rounded_box((reach, wide, 0.085 * height), 0.004), at=(x0, 0, elbow[2]), by="back")
fore.add(cylinder(0.05 * height, wide), at=(wrist_x, 0, elbow[2]), rpy=across)
obj.revolute("elbow", upper, fore, at=elbow, axis="left", range=(-0.7, 0.6), friction=0.5)
hand = obj.part("wrist", material=dark)
for y in (-wide / 2 - 0.0045, wide / 2 + 0.0045):
    hand.add(
        box((0.11 * height, 0.008, 0.08 * height)),
        at=(wrist_x - 0.03 * height, y, elbow[2]),
        by="back",
    )
front = wrist_x + 0.06 * height
hand.add(box((0.025 * height, wide + 0.017, 0.08 * height)), at=(front, 0, elbow[2]), by="back")
obj.revolute(
    "wrist_tilt",
    fore,
    hand,
    at=(wrist_x, 0, elbow[2]),
    axis="left",
    range=(-0.8, 0.5),
    friction=0.25,
)
palm = obj.part("palm", material=paint)
flange = front + 0.025 * height + 0.0005
along = (0, math.pi / 2, 0)
palm.add(cylinder(0.05 * height, 0.05 * height), at=(flange, 0, elbow[2]), rpy=along, by="back")
grip_x = flange + 0.05 * height
obj.continuous("wrist_roll", hand, palm, at=(flange, 0, elbow[2]), axis="front")
if gripper == "fingers":
    palm.add(box((0.03 * height, 0.4 * width, 0.05 * height)), at=(grip_x, 0, elbow[2]), by="back")
    start = grip_x + 0.03 * height + 0.0005
    first = None
    for side, name in ((1, "left"), (-1, "right")):
        finger = obj.part(f"{name}_finger", material=dark)
        y = side * 0.012
        finger.add(box((0.012, 0.016, 0.05 * height)), at=(start, y, elbow[2]), by="back")
        tip = box((depth / 2 - start, 0.006, 0.045 * height))
        finger.add(tip, at=(start, side * 0.0075, elbow[2]), by="back")
        way = "left" if side > 0 else "right"
        if first is None:
            first = obj.prismatic("grip", palm, finger, axis=way, range=(0, 0.13 * width))
        else:
            obj.prismatic(
                "grip_right", palm, finger, axis=way, range=(0, 0.13 * width), mimic=first
            )
else:
    palm.add(
        cylinder(0.014, depth / 2 - 0.026 - grip_x), at=(grip_x, 0, elbow[2]), rpy=along, by="back"
    )
    cup = obj.part("suction_cup", material="rubber")
    cup.add(cylinder(0.02, 0.008), at=(depth / 2, 0, elbow[2]), rpy=along, by="front")
    cup.add(cylinder(0.008, 0.0175), at=(depth / 2 - 0.008, 0, elbow[2]), rpy=along, by="front")
    obj.prismatic("cup_spring", palm, cup, axis="front", range=(0, 0.012))
