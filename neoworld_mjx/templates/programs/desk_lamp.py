# Label: desk lamp with a jointed arm
# PartNet-Mobility: Lamp
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, lathe, sphere

depth = 0.42  # 0.36 to 0.5 m
width = 0.19  # 0.17 to 0.22 m
height = 0.48  # 0.4 to 0.58 m
shade = "cone"  # one of cone, bell, bar
arms = "double"  # one of double, single
control = "knob"  # one of knob, button
colour = "red"  # one of red, black, white, brass, green

across = (math.pi / 2, 0, 0)
lamp = Object("desk_lamp", label="desk lamp with a jointed arm")
tones = {
    "red": (0.72, 0.12, 0.1),
    "black": (0.12, 0.12, 0.13),
    "white": (0.94, 0.94, 0.93),
    "brass": (0.78, 0.62, 0.28),
    "green": (0.15, 0.38, 0.25),
}
lamp.material("paint", like="aluminium", rgb=tones[colour])
base = lamp.part("base", material="paint", mass=3.0)
r, rear = width / 2, -depth / 2
x = rear + r
base.add(cylinder(r, 0.022), at=(x, 0, 0), by="bottom")
switch = lamp.part("switch", material="abs")
spot = (x + 0.6 * r, 0.3 * r, 0.0226)
if control == "knob":
    knob = switch.add(cylinder(0.011, 0.014), at=spot, by="bottom", rgb=(0.8, 0.8, 0.8))
    switch.add(
        box((0.01, 0.002, 0.001)),
        at=knob.anchor("top"),
        by="back",
        rgb=(0.1, 0.1, 0.1),
        role="visual",
    )
    lamp.revolute("dim", base, switch, at=spot, axis="down", range=(0, 4.7))
else:
    switch.add(
        cylinder(0.011, 0.008), at=(spot[0], spot[1], 0.0236), by="bottom", rgb=(0.2, 0.2, 0.2)
    )
    lamp.prismatic("switch_press", base, switch, axis="down", range=(0, 0.0014), friction=0.2)

# Each piece of the arm is a fork at its upper end and an eye at its lower end.
HEAD = 0.012
mount = lamp.part("mount", material="paint")
mount.add(cylinder(0.02, 0.012), at=(x, 0, 0.0228), by="bottom")
root = (x, 0.06)
for y in (-0.014, 0.014):
    mount.add(box((0.024, 0.006, 0.036)), at=(x, y, 0.034), by="bottom")
lamp.revolute("turn", base, mount, at=(x, 0, 0.022), axis="up", range=(-1.4, 1.4), friction=0.5)
lit = 0.075 if shade != "bar" else 0.04  # half the length of the shade along x
top = height - HEAD
elbow = (rear + 0.03, 0.62 * top)
end = (depth / 2 - lit - 0.01, top)


def limb(part, a, b, last):
    """Add a bar between points (x, z): an eye at its start, a fork or an eye at its end."""
    long, tilt = math.hypot(b[0] - a[0], b[1] - a[1]), math.atan2(b[0] - a[0], b[1] - a[1])
    part.add(cylinder(0.012, 0.02), at=(a[0], 0, a[1]), rpy=across)
    reach = long if last else long - 0.03
    middle = [a[k] + (b[k] - a[k]) * reach / long / 2 for k in (0, 1)]
    for y in (-0.0055, 0.0055):
        part.add(cylinder(0.004, reach), at=(middle[0], y, middle[1]), rpy=(0, tilt, 0))
    if last:
        part.add(cylinder(0.012, 0.02), at=(b[0], 0, b[1]), rpy=across)
        return
    near = [a[k] + (b[k] - a[k]) * (long - 0.024) / long for k in (0, 1)]
    part.add(box((0.02, 0.034, 0.012)), at=(near[0], 0, near[1]), rpy=(0, tilt, 0))
    mid = [a[k] + (b[k] - a[k]) * (long - 0.008) / long for k in (0, 1)]
    for y in (-0.014, 0.014):
        part.add(box((0.02, 0.006, 0.036)), at=(mid[0], y, mid[1]), rpy=(0, tilt, 0))


if arms == "double":
    lower = lamp.part("lower_arm", material="paint")
    limb(lower, root, elbow, False)
    lamp.revolute(
        "shoulder",
        mount,
        lower,
        at=(root[0], 0, root[1]),
        axis=(0, 1, 0),
        range=(-0.25, 0.5),
        friction=4.0,
    )
    upper = lamp.part("upper_arm", material="paint")
    limb(upper, elbow, end, True)
    lamp.revolute(
        "elbow",
        lower,
        upper,
        at=(elbow[0], 0, elbow[1]),
        axis=(0, 1, 0),
        range=(-0.3, 0.25),
        friction=3.0,
    )
else:
    upper = lamp.part("arm", material="paint")
    limb(upper, root, end, True)
    lamp.revolute(
        "shoulder",
        mount,
        upper,
        at=(root[0], 0, root[1]),
        axis=(0, 1, 0),
        range=(-0.5, 0.12),
        friction=4.0,
    )
head = lamp.part("head", material="paint")
crown = end[1] - 0.024
for y in (-0.014, 0.014):
    head.add(box((0.024, 0.006, 0.046)), at=(end[0], y, end[1] + 0.012), by="top")
head.add(box((0.024, 0.034, 0.01)), at=(end[0], 0, crown), by="top")
if shade == "bar":
    head.add(box((2 * lit + 0.02, width, 0.016)), at=(depth / 2, 0, crown - 0.009), by="front.top")
    lens = box((2 * lit, 0.9 * width, 0.002))
    head.add(lens, at=(end[0], 0, crown - 0.025), by="top", rgb=(1.0, 0.97, 0.85), role="visual")
else:
    q = lit + 0.01
    bell = [(0, 0), (0.3 * q, 0.002), (0.36 * q, 0.03), (q, 0.1)]
    if shade == "bell":
        bell = [(0, 0), (0.5 * q, 0.008), (0.85 * q, 0.035), (q, 0.08)]
    head.add(
        lathe(bell, thickness=0.0015, sectors=20),
        at=(end[0], 0, crown - 0.009),
        rpy=(math.pi, 0, 0),
    )
    head.add(cylinder(0.012, 0.03), at=(end[0], 0, crown - 0.009), by="top", rgb=(0.9, 0.9, 0.9))
    head.add(sphere(0.022), at=(end[0], 0, crown - 0.052), material="glass", rgb=(1.0, 0.95, 0.8))
lamp.revolute(
    "nod", upper, head, at=(end[0], 0, end[1]), axis=(0, -1, 0), range=(0, 0.6), friction=1.0
)
