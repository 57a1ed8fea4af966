# Label: garden gate
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, frustum, sphere

depth = 0.2  # 0.16 to 0.26 m
width = 1.4  # 1.0 to 1.8 m
height = 1.1  # 0.8 to 1.4 m
pales = 7  # 5 to 10
top = "points"  # one of points, flat, arch
leaves = "one"  # one of one, two
caps = "ball"  # one of ball, pyramid
colour = "white"  # one of white, green, wood

PAINT = {"white": (0.92, 0.92, 0.88), "green": (0.2, 0.4, 0.26), "wood": (0.6, 0.44, 0.28)}
obj = Object("swing_gate", label="garden gate")
paint = obj.material("paint", like="pine", rgb=PAINT[colour])
ground = obj.material("ground", like="concrete", rgb=(0.6, 0.58, 0.54))
POST, PLATE, GAP = 0.1, 0.05, 0.006
posts = obj.part("posts", material=paint)
posts.add(box((depth, width, PLATE)), by="bottom", material=ground)
for y in (-width / 2 + POST / 2, width / 2 - POST / 2):
    posts.add(box((POST, POST, height - PLATE - 0.06)), at=(0, y, PLATE - 0.001), by="bottom")
    cap = height - 0.0625
    posts.add(box((POST + 0.02, POST, 0.02)), at=(0, y, cap), by="bottom")
    if caps == "ball":
        posts.add(sphere(0.025), at=(0, y, height), by="top")
    else:
        posts.add(frustum(0.045, 0.004, 0.045), at=(0, y, height), by="top")

clear = width - 2 * POST
low, tall = PLATE + 0.05, height - PLATE - 0.2
panels = ((1, "left"), (-1, "right")) if leaves == "two" else ((1, "gate"),)
wide = (clear - GAP * (len(panels) + 1)) / len(panels)
x = -0.01
for side, name in panels:
    leaf = obj.part(name, material=paint)
    y = 0.0 if leaves == "one" else side * (GAP / 2 + wide / 2)
    for z in (low + 0.12 * tall, low + 0.78 * tall):
        leaf.add(box((0.03, wide, 0.07)), at=(x, y, z))
    many = pales if leaves == "one" else max(3, (pales + 1) // 2)
    pitch = wide / many
    for k in range(many):
        share = (k + 0.5) / many
        py = y - wide / 2 + (k + 0.5) * pitch
        across = share if leaves == "one" else (share if side < 0 else 1 - share) / 2
        rise = 0.12 * math.sin(math.pi * across) if top == "arch" else 0.08
        long = tall - 0.12 + rise
        leaf.add(box((0.02, 0.75 * pitch, long)), at=(x + 0.024, py, low), by="bottom")
        if top == "points":
            tip = (x + 0.024, py, low + long)
            leaf.add(box((0.0195, 0.5 * pitch, 0.5 * pitch)), at=tip, rpy=(math.pi / 4, 0, 0))
    brace = math.atan2(0.6 * tall, 0.9 * wide)
    length = math.hypot(0.6 * tall, 0.9 * wide)
    middle = (x, y, low + 0.45 * tall)
    leaf.add(box((0.026, length, 0.05)), at=middle, rpy=(side * brace, 0, 0))
    hinge_y = y + side * (wide / 2 + GAP / 2)
    for z in (low + 0.12 * tall, low + 0.78 * tall):
        knuckle = cylinder(0.01, 0.05)
        posts.add(knuckle, at=(x + 0.044, hinge_y, z), material="steel")
        leaf.add(
            box((0.018, 0.12, 0.03)), at=(x + 0.039, hinge_y - side * 0.071, z), material="steel"
        )
        strap = box((0.02, 0.024, 0.03))
        posts.add(strap, at=(x + 0.044, hinge_y + side * 0.014, z), material="steel")
    obj.revolute(
        f"{name}_swing", posts, leaf, at=(x + 0.044, hinge_y, low), axis=(0, 0, side),
        range=(0, 1.5), opens="front",
    )  # fmt: skip
    latch = obj.part(f"{name}_latch", material="steel")
    ly = y - side * (wide / 2 - 0.08)
    lz = low + 0.78 * tall
    hub = (x - 0.0155, ly, lz)
    latch.add(cylinder(0.012, 0.01), at=hub, rpy=(0, math.pi / 2, 0), by="front")
    latch.add(box((0.008, 0.1, 0.018)), at=(x - 0.0165, ly + side * 0.04, lz), by="front")
    obj.revolute(
        f"{name}_latch_turn",
        leaf,
        latch,
        at=hub,
        axis=(-side, 0, 0),
        range=(-1.0, 0.3),
        friction=0.4,
    )
