# Label: microscope
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, frustum, panel, rounded_box, sweep

depth = 0.24  # 0.2 to 0.3 m
width = 0.18  # 0.15 to 0.22 m
height = 0.36  # 0.3 to 0.44 m
objectives = 3  # 2 to 4
eyepieces = "two"  # one of one, two
colour = "white"  # one of white, black, grey

SHADE = {"white": (0.9, 0.9, 0.88), "black": (0.13, 0.13, 0.14), "grey": (0.6, 0.62, 0.64)}
D, H = depth, height
obj = Object("microscope", label="microscope")
enamel = obj.material("enamel", like="aluminium", density=1200, rgb=SHADE[colour])
dark = obj.material("dark", like="abs", rgb=(0.1, 0.1, 0.11))
across = (math.pi / 2, 0, 0)
body = obj.part("stand", material=enamel)
body.add(rounded_box((D, 0.75 * width, 0.1 * H), 0.008), at=(D / 2, 0, 0), by="front.bottom")
light = (0.2 * D, 0, 0.1 * H - 0.002)
body.add(frustum(0.14 * D, 0.09 * D, 0.05 * H), at=light, by="bottom", material=dark)
limb_x = -0.36 * D
body.add(box((0.16 * D, 0.24 * width, 0.62 * H)), at=(limb_x, 0, 0.08 * H), by="bottom")
head_z = 0.66 * H
body.add(
    rounded_box((0.66 * D, 0.26 * width, 0.1 * H), 0.006),
    at=(limb_x - 0.08 * D, 0, head_z),
    by="back.bottom",
)
axis_x = 0.2 * D
tilt = 0.7
tops = [(-0.03, 0.26), (0.03, 0.26)] if eyepieces == "two" else [(0.0, 0.26)]
prism_z = head_z + 0.1 * H
body.add(cylinder(0.11 * D, 0.06 * H), at=(axis_x - 0.06 * D, 0, prism_z - 0.001), by="bottom")
for y, _ in tops:
    # The eyepieces lean back towards the one who looks in, behind the limb.
    start = (axis_x - 0.06 * D, y, prism_z + 0.04 * H)
    reach = (H - start[2] - 0.012) / math.cos(tilt)
    end = (start[0] - reach * math.sin(tilt), y, start[2] + reach * math.cos(tilt))
    body.add(sweep([start, end], radius=0.0135, sectors=12))
    mid = (start[0] - 0.8 * reach * math.sin(tilt), y, start[2] + 0.8 * reach * math.cos(tilt))
    lens = cylinder(0.0165, 0.4 * reach)
    body.add(lens, at=mid, rpy=(0, -tilt, 0), material=dark)
body.add(
    box((0.09 * D, 0.06 if eyepieces == "two" else 0.03, 0.05 * H)),
    at=(axis_x - 0.08 * D, 0, prism_z + 0.03 * H),
)

# The revolver turns below the head; the stage runs on the limb, driven by the focus knob.
nose = obj.part("revolver", material="steel")
nose.add(cylinder(0.13 * D, 0.03 * H), at=(axis_x, 0, head_z - 0.0005), by="top")
for k in range(objectives):
    t = 2 * math.pi * k / objectives
    long = (0.12 - 0.02 * k) * H
    at = (axis_x + 0.075 * D * math.cos(t), 0.075 * D * math.sin(t), head_z - 0.03 * H)
    nose.add(frustum(0.026 * D, 0.038 * D, long), at=at, by="top")
    ring = (at[0], at[1], at[2] - 0.3 * long)
    nose.add(
        cylinder(0.038 * D, 0.006),
        at=ring,
        rgb=[(0.8, 0.2, 0.1), (0.9, 0.8, 0.2), (0.2, 0.5, 0.8), (0.9, 0.9, 0.9)][k],
    )
obj.continuous("revolve", body, nose, at=(axis_x, 0, head_z), axis="top")
stage = obj.part("stage", material=dark)
z, front_of_limb = 0.4 * H, limb_x + 0.08 * D + 0.0005
plate = panel((0.56 * D, 0.72 * width), 0.03 * H, holes=[(0.01 * D, 0, 0.03 * D)])
stage.add(plate, at=(front_of_limb + 0.28 * D, 0, z))
stage.add(box((0.03 * D, 0.2 * width, 0.1 * H)), at=(front_of_limb, 0, z), by="back")
travel = head_z - 0.03 * H - 0.12 * H - z - 0.015 * H - 0.012
lift = 0.09 * H
drop = min(lift, z - 0.16 * H)
focus = obj.prismatic("focus", body, stage, axis="bottom", range=(0, drop), friction=4)
slide = obj.part("slide", material="glass")
top = z + 0.015 * H + 0.0005
slide.add(box((0.026, 0.5 * width, 0.0015)), at=(axis_x - 0.05 * D, 0, top), by="bottom")
obj.prismatic("slide_shift", stage, slide, axis="left", range=(-0.05 * width, 0.05 * width))
knob_z = 0.24 * H
for name, r, near, far in (("coarse", 0.085 * D, 0.12, 0.34), ("fine", 0.05 * D, 0.345, 0.5)):
    knob = obj.part(f"{name}_knob", material=dark)
    for side in (1, -1):
        y, out = side * (near * width + 0.0005), (far - near) * width - 0.0005
        at = (limb_x, y, knob_z)
        knob.add(cylinder(r, out), at=at, rpy=across, by="right" if side > 0 else "left")
    axis = (0, 1, 0)
    if name == "coarse":
        obj.revolute(
            "coarse_turn",
            body,
            knob,
            at=(limb_x, 0, knob_z),
            axis=axis,
            range=(0, 3.0),
            mimic=focus,
            multiplier=3.0 / drop,
        )
        coarse = knob
    else:
        obj.continuous("fine_turn", coarse, knob, at=(limb_x, 0, knob_z), axis=axis)
