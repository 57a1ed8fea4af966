# Label: window with shutters
import math

from neoworld_mjx.program.sdk import Object, box, cylinder

depth = 0.14  # 0.11 to 0.18 m
width = 1.0  # 0.8 to 1.3 m
height = 1.1  # 0.85 to 1.4 m
slats = 8  # 5 to 12
leaves = "slatted"  # one of slatted, boards
sill = "deep"  # one of deep, plain
colour = "green"  # one of green, blue, white, brown

PAINT = {"green": (0.18, 0.36, 0.25), "blue": (0.25, 0.42, 0.6), "white": (0.9, 0.9, 0.87)}
obj = Object("window_shutters", label="window with shutters")
paint = obj.material("paint", like="pine", rgb=PAINT.get(colour, (0.36, 0.24, 0.16)))
trim = obj.material("trim", like="pine", rgb=(0.9, 0.89, 0.85))
stone = obj.material("sill", like="stone", density=900, rgb=(0.62, 0.6, 0.57))
FRAME, LEAF, SILL = 0.07, 0.03, 0.05
out = 0.03 if sill == "deep" else 0.0
back, x = -depth / 2, depth / 2 - LEAF - 0.0105
frame = obj.part("frame", material=trim)
deep = x - back
frame.add(box((depth, width, SILL)), at=(back, 0, 0), by="back.bottom", material=stone)
for y in (-width / 2, width / 2):
    side = "left" if y > 0 else "right"
    post = box((deep, FRAME, height - SILL + 0.001))
    frame.add(post, at=(back, y, height), by=f"back.top.{side}")
frame.add(box((deep, width, FRAME)), at=(back, 0, height), by="back.top")
mid = (SILL + height - FRAME) / 2
clear = height - FRAME - SILL
pane = box((0.006, width - 2 * FRAME + 0.01, clear + 0.01))
glass = obj.material("pane", like="glass", rgb=(0.6, 0.72, 0.8), alpha=0.5)
frame.add(pane, at=(back + 0.02, 0, mid), material=glass)
frame.add(box((0.03, 0.04, clear)), at=(back + 0.022, 0, mid))
frame.add(box((0.03, width - 2 * FRAME, 0.025)), at=(back + 0.022, 0, mid))

# Each shutter turns about its outer edge; in a slatted one the slats tilt together.
low, tall = SILL + 0.002, height - SILL - 0.004
wide, stile = width / 2 - 0.002, 0.078
for side, name in ((1, "left"), (-1, "right")):
    leaf = obj.part(f"{name}_shutter", material=paint)
    y = side * (0.001 + wide / 2)
    plane = x + 0.0005
    for off in (-wide / 2 + stile / 2, wide / 2 - stile / 2):
        leaf.add(box((LEAF, stile, tall)), at=(plane, y + off, low), by="back.bottom")
    rails = (low + stile / 2, low + tall - stile / 2)
    for z in rails:
        leaf.add(box((LEAF, wide, stile)), at=(plane, y, z), by="back")
    pivot = (plane + LEAF, side * width / 2, mid)
    obj.revolute(
        f"{name}_hinge", frame, leaf, at=pivot, axis=(0, 0, side), range=(0, 1.57), friction=0.3
    )
    knob = (plane + LEAF, side * 0.03, mid)
    leaf.add(cylinder(0.008, 0.01), at=knob, rpy=(0, math.pi / 2, 0), by="back", material="brass")
    inner, span = wide - 2 * stile, tall - 2 * stile
    if leaves == "boards":
        leaf.add(box((0.016, inner + 0.004, span + 0.004)), at=(plane + 0.005, y, mid), by="back")
        brace = math.atan2(span, inner)
        long = 0.93 * math.hypot(span, inner)
        at = (plane + 0.025, y, mid)
        leaf.add(box((0.012, long, 0.05)), at=at, rpy=(side * brace, 0, 0))
        continue
    pitch, first = span / slats, None
    # A slat that tilts must not reach the bars behind it.
    room = LEAF / 2 + x - (back + 0.054)
    tilt = min(1.2, math.asin(min(1.0, room / (0.4 * pitch))))
    for k in range(slats):
        slat = obj.part(f"{name}_slat_{k + 1}", material=paint)
        at = (plane + LEAF / 2, y, low + stile + (k + 0.5) * pitch)
        slat.add(box((0.008, inner - 0.002, 0.8 * pitch)), at=at)
        joint = f"{name}_slat_{k + 1}_tilt"
        if first is None:
            first = obj.revolute(
                joint, leaf, slat, at=at, axis="left", range=(0, tilt), friction=0.05
            )
        else:
            obj.revolute(joint, leaf, slat, at=at, axis="left", range=(0, tilt), mimic=first)
