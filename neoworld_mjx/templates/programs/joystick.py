# Label: joystick
import math

from neoworld_mjx.program.sdk import (
    Object,
    box,
    cylinder,
    lathe,
    rounded_box,
    sphere,
    sweep,
    tube,
)

depth = 0.19  # 0.16 to 0.23 m
width = 0.17  # 0.15 to 0.22 m
height = 0.22  # 0.18 to 0.26 m
buttons = 4  # 2 to 5
base_shape = "square"  # one of square, round
throttle = "lever"  # one of lever, wheel
accent = "red"  # one of red, blue, green

TINT = {"red": (0.8, 0.12, 0.1), "blue": (0.15, 0.35, 0.8), "green": (0.2, 0.6, 0.3)}
obj = Object("joystick", label="joystick")
shell = obj.material("shell", like="abs", rgb=(0.14, 0.14, 0.15))
soft = obj.material("soft", like="rubber", density=500, rgb=(0.22, 0.22, 0.24))
glow = obj.material("accent", like="abs", rgb=TINT[accent])
B = 0.045
base = obj.part("base", material=shell, mass=0.9)
if base_shape == "square":
    base.add(rounded_box((depth, width, B), 0.012), by="bottom")
else:
    oval = [(0, 0), (depth / 2, 0), (depth / 2, 0.02), (0.38 * depth, B)]
    base.add(lathe(oval, oval=width / depth))
stick_x, ball = 0.14 * depth, 0.02
pivot = (stick_x, 0, B + ball + 0.0005)
for r, z in ((0.038, 0.004), (0.033, 0.011)):
    base.add(tube(r + 0.006, 0.012, 0.009), at=(stick_x, 0, B + z), material=soft)

# The stick's ball lies in the collar, whose opening limits how far it leans.
stick = obj.part("stick", material=shell)
stick.add(sphere(ball), at=pivot)
path = [
    (stick_x, 0, pivot[2]),
    (stick_x - 0.004, 0, 0.55 * height),
    (stick_x + 0.006, 0, height - 0.034),
]
stick.add(sweep(path, radius=[0.013, 0.0155, 0.0165], sectors=8), material=soft)
top = height - 0.006
head = rounded_box((0.046, 0.04, 0.036), 0.008)
stick.add(head, at=(stick_x, 0, top), by="top")
stick.add(box((0.03, 0.05, 0.008)), at=(stick_x, 0, 0.42 * height))
obj.ball("lean", base, stick, at=pivot, swing=0.3, friction=0.25)
fire = obj.part("fire_button", material=glow)
fire.add(cylinder(0.007, 0.0055), at=(stick_x + 0.009, 0.008, height), by="top")
obj.prismatic("fire", stick, fire, axis="bottom", range=(0, 0.001))
hat = obj.part("hat", material=soft)
hat.add(cylinder(0.008, 0.0055), at=(stick_x - 0.01, -0.008, height), by="top")
obj.revolute(
    "hat_turn", stick, hat, at=(stick_x - 0.01, -0.008, top), axis="top", range=(-0.6, 0.6)
)
trigger = obj.part("trigger", material=glow)
pin = (stick_x + 0.0285, 0, top - 0.03)
trigger.add(cylinder(0.005, 0.012), at=pin, rpy=(math.pi / 2, 0, 0))
curve = [pin, (pin[0] + 0.003, 0, pin[2] - 0.012), (pin[0] + 0.008, 0, pin[2] - 0.024)]
trigger.add(sweep(curve, width=0.01, thickness=0.004))
obj.revolute("pull", stick, trigger, at=pin, axis=(0, 1, 0), range=(0, 0.18), friction=0.03)
for k in range(buttons):
    button = obj.part(f"button_{k + 1}", material=glow if k % 2 == 0 else soft)
    side = 1 if k % 2 else -1
    at = (-0.2 * depth + 0.019 * (k // 2), side * 0.33 * width, B + 0.0005)
    button.add(cylinder(0.008, 0.005), at=at, by="bottom")
    base.add(cylinder(0.0115, 0.001), at=(at[0], at[1], B), role="visual", material=soft)
    obj.prismatic(f"press_{k + 1}", base, button, axis="bottom", range=(0, 0.0012))
slide = obj.part("throttle", material=soft)
place = (-0.34 * depth, 0, B + 0.0005)
if throttle == "lever":
    for y in (-0.014, 0.014):
        base.add(box((0.02, 0.006, 0.02)), at=(place[0], y, B - 0.001), by="bottom")
    hinge = (place[0], 0, B + 0.0105)
    slide.add(cylinder(0.009, 0.02), at=hinge, rpy=(math.pi / 2, 0, 0))
    slide.add(box((0.008, 0.018, 0.03)), at=(hinge[0], 0, hinge[2]), by="bottom")
    slide.add(
        cylinder(0.006, 0.03),
        at=(hinge[0], 0, hinge[2] + 0.03),
        rpy=(math.pi / 2, 0, 0),
        material=glow,
    )
    obj.revolute(
        "throttle_turn", base, slide, at=hinge, axis=(0, 1, 0), range=(-0.7, 0.7), friction=0.02
    )
else:
    slide.add(cylinder(0.018, 0.01), at=place, by="bottom")
    obj.revolute("throttle_turn", base, slide, at=place, axis="top", range=(-2.0, 2.0))
