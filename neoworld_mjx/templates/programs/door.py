# Label: door in its frame
# PartNet-Mobility: Door
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, mirror, panel, sphere

depth = 0.3  # 0.27 to 0.38 m
width = 1.0  # 0.85 to 1.9 m
height = 2.15  # 2.0 to 2.4 m
leaves = 1  # 1 to 2
style = "panels"  # one of panels, glazed, plain
grip = "lever"  # one of lever, knob
wood = "oak"  # one of oak, walnut, pine, white, green

JAMB, LEAF, SILL, GAP = 0.06, 0.04, 0.02, 0.0018
OUT = 0.065
flat, across = (0, math.pi / 2, 0), (math.pi / 2, 0, 0)
door = Object("door", label="door in its frame")
painted = {"white": (0.93, 0.92, 0.89), "green": (0.15, 0.32, 0.25)}
if wood in painted:
    door.material("timber", like="pine", rgb=painted[wood])
else:
    door.material("timber", like=wood)
door.material("pane", like="glass", alpha=0.45)
frame = door.part("frame", material="timber")
deep = depth - OUT
x = deep / 2
for jamb in mirror((0, width / 2, 0)):
    by = "left.bottom" if jamb[1] > 0 else "right.bottom"
    frame.add(
        box((deep, JAMB, height)), at=jamb, by=by, name="jamb_left" if jamb[1] > 0 else "jamb_right"
    )
frame.add(box((deep, width - 2 * JAMB, JAMB)), at=(0, 0, height), by="top")
frame.add(box((deep, width - 2 * JAMB, SILL)), by="bottom", material="stone")
low, high = SILL + GAP, height - JAMB - GAP
edges = [-width / 2 + JAMB + GAP, width / 2 - JAMB - GAP]
spans = [(edges[0], edges[1])] if leaves == 1 else [(edges[0], -0.0015), (0.0015, edges[1])]


def fill(part, y, size):
    """Fill a leaf's frame, whose middle is at y, as its style says."""
    tall, wide = size[1] - 0.28, size[0] - 0.2
    upright = (math.pi / 2, 0, math.pi / 2)
    middle = (x - LEAF / 2, y, (low + high) / 2)
    if style == "plain":
        part.add(box((LEAF, *size)), at=middle, name="board")
        return
    holes = [(0, 0.22 * tall + 0.03, wide, 0.56 * tall), (0, -0.34 * tall, wide, 0.32 * tall)]
    part.add(panel(size, LEAF, holes), at=middle, rpy=upright, name="stiles")
    for k, (_, dz, w, h) in enumerate(holes):
        pane = style == "glazed" and k == 0
        at = (middle[0], y, middle[2] + dz)
        part.add(
            box((0.008 if pane else 0.02, w + 0.01, h + 0.01)),
            at=at,
            material="pane" if pane else "timber",
        )
        if not pane:
            part.add(box((0.03, w - 0.08, h - 0.08)), at=at)
        else:
            part.add(box((0.02, 0.018, h + 0.01)), at=at)
            part.add(box((0.02, w + 0.01, 0.018)), at=at)


for k, (right, left) in enumerate(spans):
    side = "right" if k == 0 else "left"
    leaf = door.part(f"{side}_leaf", material="timber")
    fill(leaf, (left + right) / 2, (left - right, high - low))
    sign = -1 if side == "right" else 1
    hinge = leaf.anchor(f"{side}.front")
    swing = door.revolute(
        f"{side}_hinge",
        frame,
        leaf,
        at=hinge,
        axis=(0, 0, sign),
        range=(0, 1.6),
        opens="front",
        friction=0.5,
    )
    # Handles on both faces turn together.
    inner = (left if side == "right" else right) + sign * 0.055
    turn = None
    for face, way in ((x, 1), (x - LEAF, -1)):
        name = f"{side}_handle_{'out' if way > 0 else 'in'}"
        handle = door.part(name, material="brass" if grip == "knob" else "stainless_steel")
        by = "back" if way > 0 else "front"
        at = (face + way * 0.0006, inner, 1.0)
        handle.add(cylinder(0.024, 0.008), at=at, rpy=flat, by=by)
        stem = OUT - 0.0006 - (0.004 if grip == "lever" else 0.02)
        handle.add(cylinder(0.009, stem), at=at, rpy=flat, by=by)
        end = (face + way * OUT, inner, 1.0)
        if grip == "knob":
            handle.add(sphere(0.027), at=end, by="front" if way > 0 else "back")
        else:
            arm = (end[0], inner - sign * 0.01, 1.0)
            by = ("front" if way > 0 else "back") + (".left" if sign < 0 else ".right")
            handle.add(box((0.016, 0.12, 0.02)), at=arm, by=by)
        axis = (sign, 0, 0)
        joint = door.revolute(
            f"{name}_turn", leaf, handle, at=at, axis=axis, range=(0, 0.8), mimic=turn, friction=0.3
        )
        turn = turn or joint
    bolt = door.part(f"{side}_bolt", material="brass")
    leaf.add(
        cylinder(0.02, 0.004), at=(x - 0.001, inner, 1.12), rpy=flat, by="back", material="brass"
    )
    bolt.add(cylinder(0.012, 0.01), at=(x + 0.0036, inner, 1.12), rpy=flat, by="back")
    bolt.add(box((0.012, 0.006, 0.03)), at=(x + 0.012, inner, 1.12), by="back")
    door.revolute(
        f"{side}_bolt_turn", leaf, bolt, at=(x, inner, 1.12), axis="front", range=(0, 1.57)
    )
if leaves == 1:
    # A flap for letters before a slot in the lower rail.
    flap = door.part("letter_flap", material="brass")
    at = (x + 0.0008, -0.03, low + 0.42 * (high - low))
    flap.add(box((0.005, 0.24, 0.05)), at=at, by="back.top")
    door.revolute(
        "flap_hinge", leaf, flap, at="top.hinge", range=(0, 1.2), friction=0.05, damping=0.06
    )
