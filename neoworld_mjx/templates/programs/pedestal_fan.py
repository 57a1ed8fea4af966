# Label: pedestal fan
# PartNet-Mobility: Fan
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, frustum, ring, sweep, torus, tube

depth = 0.36  # 0.34 to 0.38 m
width = 0.42  # 0.38 to 0.48 m
height = 1.05  # 0.8 to 1.25 m
blades = 3  # 3 to 5
buttons = 4  # 3 to 5
foot = "disc"  # one of disc, cross
colour = "white"  # one of white, black, mint

flat = (0, math.pi / 2, 0)
fan = Object("pedestal_fan", label="pedestal fan")
tones = {"white": (0.93, 0.93, 0.92), "black": (0.13, 0.13, 0.14), "mint": (0.65, 0.84, 0.78)}
fan.material("case", like="abs", rgb=tones[colour])
fan.material("blade", like="acrylic", rgb=(0.5, 0.65, 0.8), alpha=0.75)
base = fan.part("base", material="case", mass=4.0)
reach = depth / 2
if foot == "disc":
    base.add(cylinder(reach, 0.018), by="bottom")
    base.add(frustum(0.6 * reach, 0.03, 0.02), at=(0, 0, 0.017), by="bottom")
else:
    for turn in (math.pi / 4, -math.pi / 4):
        beam = depth * math.sqrt(2) - 0.05
        base.add(box((beam, 0.05, 0.025)), rpy=(0, 0, turn), by="bottom")
    base.add(cylinder(0.08, 0.035), by="bottom")
r = width / 2
centre = height - r
stem = centre - 0.12
column = 0.55 * stem
base.add(
    tube(0.018, 0.0045, column - 0.03, sectors=16),
    at=(0, 0, 0.03),
    by="bottom",
    material="aluminium",
)
base.add(box((0.03, 0.07, 0.14)), at=(0.0335, 0, column - 0.14), by="bottom")
for k in range(buttons):
    button = fan.part(f"button_{k + 1}", material="abs")
    at = (0.05, 0, column - 0.115 + 0.024 * k)
    button.add(
        box((0.006, 0.04, 0.015)),
        at=at,
        by="back",
        rgb=(0.55, 0.6, 0.65) if k else (0.8, 0.15, 0.1),
    )
    fan.prismatic(f"press_{k + 1}", base, button, axis="back", range=(0, 0.0018))

pole = fan.part("pole", material="aluminium")
pole.add(cylinder(0.012, stem - 0.06), at=(0, 0, 0.06), by="bottom")
base.add(cylinder(0.016, 0.029), at=(0, 0, 0.03), by="bottom")
pole.add(cylinder(0.024, 0.03), at=(0, 0, stem), by="top", material="case")
fan.prismatic("lift", base, pole, axis="up", range=(0, 0.3 * column), friction=30)
neck = fan.part("neck", material="case")
neck.add(cylinder(0.022, 0.03), at=(0, 0, stem + 0.0008), by="bottom")
for y in (-0.03, 0.03):
    neck.add(box((0.03, 0.008, centre - stem + 0.012)), at=(0, y, stem + 0.016), by="bottom")
neck.add(box((0.03, 0.06, 0.014)), at=(0, 0, stem + 0.016), by="bottom")
fan.revolute("oscillate", pole, neck, at=(0, 0, stem), axis="up", range=(-0.8, 0.8), friction=0.3)
head = fan.part("head", material="case")
# The motor turns between the cheeks of the neck; the guard hangs on its front.
head.add(cylinder(0.022, 0.05), at=(0, 0, centre), rpy=(math.pi / 2, 0, 0))
head.add(frustum(0.03, 0.05, 0.06), at=(-0.02, 0, centre), rpy=(0, -math.pi / 2, 0), by="front")
head.add(cylinder(0.022, 0.06), at=(-0.03, 0, centre), rpy=flat, by="back")
fan.revolute(
    "tilt", neck, head, at=(0, 0, centre), axis=(0, -1, 0), range=(-0.15, 0.25), friction=6
)
knob = fan.part("oscillation_knob", material="abs")
knob.add(
    cylinder(0.006, 0.012), at=(-0.068, 0, centre + 0.0482), by="bottom", rgb=(0.4, 0.42, 0.45)
)
fan.prismatic("oscillation_pull", head, knob, axis="up", range=(0, 0.008), friction=1.0)

near, far = 0.065, depth / 2 - 0.004
head.add(cylinder(0.022, near + 0.02), at=(-0.02, 0, centre), rpy=flat, by="back")
wire = 0.003
for x, q in ((near, 0.85 * r), ((near + far) / 2, r - wire), (far, 0.75 * r)):
    head.add(torus(q, wire), at=(x, 0, centre), rpy=flat)
head.add(cylinder(0.035, 0.004), at=(near, 0, centre), rpy=flat)
head.add(cylinder(0.04, 0.006), at=(far - 0.001, 0, centre), rpy=flat)
for dy, dz, _ in ring(14, 1.0):
    # Each wire bends over the guard's edge from the motor to the badge in front.
    line = [
        (near, 0.03),
        (near, 0.85 * r),
        ((near + far) / 2, r - wire),
        (far, 0.75 * r),
        (far, 0.035),
    ]
    head.add(sweep([(px, q * dy, centre + q * dz) for px, q in line], radius=0.0016))
rotor = fan.part("rotor", material="blade")
mid = (near + far) / 2 + 0.01
rotor.add(cylinder(0.035, 0.04), at=(mid, 0, centre), rpy=flat, material="case")
head.add(
    cylinder(0.008, mid - 0.0208 - near),
    at=(near, 0, centre),
    rpy=flat,
    by="back",
    material="steel",
)
for k in range(blades):
    a = 2 * math.pi * k / blades
    out = 0.5 * (0.03 + 0.86 * r)
    at = (mid, out * math.sin(a), centre + out * math.cos(a))
    rotor.add(
        box((0.003, min(0.1, 0.3 * r * 3 / blades + 0.03), 0.86 * r - 0.03)), at=at, rpy=(-a, 0, 0)
    )
fan.continuous("spin", head, rotor, at=(mid, 0, centre), axis="front")
