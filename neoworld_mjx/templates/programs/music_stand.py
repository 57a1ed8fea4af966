# Label: music stand
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, mirror, sweep, tube

depth = 0.5  # 0.42 to 0.6 m
width = 0.5  # 0.42 to 0.6 m
height = 1.1  # 0.85 to 1.3 m
legs = 3  # 3 to 4
desk = "solid"  # one of solid, pierced, wire
arms = "yes"  # one of yes, no
finish = "black"  # one of black, chrome, brass

LOOK = {"black": (0.12, 0.12, 0.13), "chrome": (0.78, 0.8, 0.82), "brass": (0.76, 0.6, 0.28)}
obj = Object("music_stand", label="music stand")
coat = obj.material("coat", like="aluminium", density=1800, rgb=LOOK[finish])
base = obj.part("base", material=coat)
low = 0.5 * height
hub = 0.18
base.add(tube(0.014, 0.003, low - 0.06), at=(0, 0, low), by="top")
base.add(cylinder(0.024, 0.04), at=(0, 0, hub), by="centre")
ends = [
    (depth / 2 - 0.012, 0.0),
    (0.012 - depth / 2, 0.4 * width),
    (0.012 - depth / 2, -0.4 * width),
]
if legs == 4:
    ends = mirror(mirror((depth / 2 - 0.012, 0.35 * width, 0)), "x")
for end in ends:
    far = math.hypot(end[0], end[1])
    x, y = end[0] / far, end[1] / far
    knee = (0.6 * end[0], 0.6 * end[1], 0.13)
    path = [(0.015 * x, 0.015 * y, hub), knee, (end[0], end[1], 0.01)]
    base.add(sweep(path, radius=0.008))
    base.add(cylinder(0.012, 0.012), at=(end[0], end[1], 0), by="bottom", material="rubber")
base.add(tube(0.019, 0.0055, 0.035), at=(0, 0, low), by="top")
knob = obj.part("clamp", material="abs")
spot = (0, 0.0195, low - 0.018)
turned = (math.pi / 2, 0, 0)
knob.add(cylinder(0.005, 0.014), at=spot, rpy=turned, by="right")
knob.add(cylinder(0.014, 0.012), at=(0, 0.0335, spot[2]), rpy=turned, by="right")
obj.continuous("clamp_turn", base, knob, at=spot, axis="left")

post = obj.part("post", material=coat)
tall, lean = 0.3, 0.35
head = height - 0.5 * tall * math.cos(lean) - 0.002
post.add(cylinder(0.0095, head - 0.02 - 0.6 * low), at=(0, 0, head - 0.02), by="top")
post.add(box((0.012, 0.03, 0.04)), at=(0, 0, head - 0.012))
obj.prismatic("height_slide", base, post, axis="top", range=(0, 0.3 * low), friction=14)

# The desk faces the front and leans back; its ledge holds the sheets.
tray = obj.part("desk", material=coat)


def on_desk(y, up, out):
    """Return a point of the desk by its height along the slope and its distance before it."""
    x = 0.016 + out * math.cos(lean) - up * math.sin(lean)
    return (x, y, head + up * math.cos(lean) + out * math.sin(lean))


flat, wide = (0, -lean, 0), width
if desk == "wire":
    for y in (-0.48, -0.2, 0.2, 0.48):
        tray.add(box((0.005, 0.008, tall)), at=on_desk(y * wide, 0, 0), rpy=flat)
    for up in (-0.46, 0.0, 0.46):
        tray.add(box((0.005, wide, 0.012)), at=on_desk(0, up * tall, 0), rpy=flat)
elif desk == "pierced":
    for up in (-0.5, -0.17, 0.17, 0.5):
        tray.add(box((0.004, wide, 0.18 * tall)), at=on_desk(0, 0.82 * up * tall, 0), rpy=flat)
    for y in (-0.46, 0, 0.46):
        tray.add(box((0.004, 0.08 * wide, tall)), at=on_desk(y * wide, 0, 0), rpy=flat)
else:
    tray.add(box((0.004, wide, tall)), at=on_desk(0, 0, 0), rpy=flat)
ledge = box((0.055, 0.94 * wide, 0.004))
tray.add(ledge, at=on_desk(0, -0.5 * tall + 0.004, 0.026), rpy=flat)
for y in (-0.0215, 0.0215):
    tray.add(box((0.03, 0.01, 0.03)), at=on_desk(y, 0, -0.014), rpy=flat)
pivot = (0, 0, head)
obj.revolute("desk_tilt", post, tray, at=pivot, axis=(0, -1, 0), range=(-0.3, 0.9), friction=2.5)
if arms == "yes":
    for side, name in ((1, "left"), (-1, "right")):
        arm = obj.part(f"{name}_page_arm", material="steel")
        pin = on_desk(side * 0.2 * wide, -0.5 * tall + 0.016, 0.0048)
        arm.add(box((0.004, 0.012, 0.012)), at=pin, rpy=flat)
        arm.add(
            box((0.004, 0.006, 0.45 * tall)),
            at=on_desk(side * 0.2 * wide, -0.275 * tall + 0.016, 0.0048),
            rpy=flat,
        )
        normal = (-side * math.cos(lean), 0, -side * math.sin(lean))
        obj.revolute(
            f"{name}_arm_turn", tray, arm, at=pin, axis=normal, range=(0, 1.2), friction=0.06
        )
