# Label: window
# PartNet-Mobility: Window
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, mirror, panel

depth = 0.24  # 0.2 to 0.32 m
width = 1.2  # 0.9 to 1.6 m
height = 1.1  # 0.8 to 1.3 m
opens = "casement"  # one of casement, sliding, hung
vent = "yes"  # one of yes, no
bars = 1  # 0 to 2
colour = "white"  # one of white, oak, dark, green

FRAME, SASH, SILL, OUT, RAIL = 0.055, 0.045, 0.03, 0.05, 0.055
upright = (math.pi / 2, 0, math.pi / 2)
window = Object("window", label="window")
shade = {
    "white": (0.94, 0.94, 0.92),
    "oak": (0.62, 0.45, 0.28),
    "dark": (0.2, 0.2, 0.21),
    "green": (0.2, 0.36, 0.28),
}
window.material("paint", like="pine", rgb=shade[colour])
window.material("pane", like="glass", rgb=(0.75, 0.86, 0.92), alpha=0.4)
frame = window.part("frame", material="paint")
deep = depth - OUT
x = deep / 2
frame.add(box((deep, width, SILL)), at=(0, 0, 0), by="bottom", name="sill", material="stone")
frame.add(box((deep, width, FRAME)), at=(0, 0, height), by="top")
for side in mirror((0, width / 2, SILL)):
    by = "left.bottom" if side[1] > 0 else "right.bottom"
    frame.add(box((deep, FRAME, height - SILL - FRAME)), at=side, by=by)
low, high = SILL, height - FRAME
right, left = -width / 2 + FRAME, width / 2 - FRAME
if vent == "yes":
    # A flap of its own above the sashes, hung at its top.
    beam = high - 0.22 * (high - low)
    frame.add(box((deep, left - right, 0.04)), at=(0, 0, beam), by="top")


def sash(name, y, z, front):
    """Add a glazed sash within y and z; its front lies in the plane front."""
    part = window.part(name, material="paint")
    size = (y[1] - y[0], z[1] - z[0])
    middle = (front - SASH / 2, (y[0] + y[1]) / 2, (z[0] + z[1]) / 2)
    hole = (0, 0, size[0] - 2 * RAIL, size[1] - 2 * RAIL)
    part.add(panel(size, SASH, [hole]), at=middle, rpy=upright)
    part.add(box((0.008, hole[2] + 0.01, hole[3] + 0.01)), at=middle, material="pane")
    for k in range(bars if size[1] > 0.35 else 0):
        dz = ((k + 1) / (bars + 1) - 0.5) * hole[3]
        part.add(box((0.025, hole[2] + 0.01, 0.016)), at=(middle[0], middle[1], middle[2] + dz))
    return part


if vent == "yes":
    flap = sash("vent", (right + 0.002, left - 0.002), (beam + 0.008, high - 0.0015), x)
    window.revolute(
        "vent_hinge",
        frame,
        flap,
        at=flap.anchor("top.front"),
        axis=(0, -1, 0),
        range=(0, 0.7),
        opens="front",
    )
    knob = (x - 0.002, 0, beam + 0.03)
    flap.add(cylinder(0.014, 0.03), at=knob, rpy=(0, math.pi / 2, 0), by="back", material="steel")
    high = beam - 0.04
if opens == "casement":
    for side, y in (("right", (right + 0.002, -0.001)), ("left", (0.001, left - 0.002))):
        leaf = sash(f"{side}_sash", y, (low + 0.002, high - 0.002), x)
        sign = 1 if side == "left" else -1
        at = leaf.anchor(f"{side}.front")
        window.revolute(
            f"{side}_hinge",
            frame,
            leaf,
            at=at,
            axis=(0, 0, sign),
            range=(0, 1.57),
            opens="front",
            friction=0.3,
        )
        handle = window.part(f"{side}_handle", material="aluminium")
        spot = (x + 0.0008, sign * 0.028, (low + high) / 2)
        handle.add(cylinder(0.013, OUT - 0.0008), at=spot, rpy=(0, math.pi / 2, 0), by="back")
        tip = (x + OUT, spot[1], spot[2] + 0.012)
        handle.add(box((0.014, 0.018, 0.12)), at=tip, by="front.top")
        window.revolute(
            f"{side}_turn", leaf, handle, at=spot, axis=(sign, 0, 0), range=(0, 1.57), friction=0.2
        )
else:
    # Two sashes in two planes, one behind the other, that overlap by a rail.
    planes = (x - 0.004, x - 0.006 - SASH)
    half = RAIL / 2
    if opens == "sliding":
        spans = [
            ((right + 0.001, half), (low + 0.001, high - 0.001)),
            ((-half, left - 0.001), (low + 0.001, high - 0.001)),
        ]
        ways, travel = ("left", "right"), (left - right) / 2 - RAIL
    else:
        middle = (low + high) / 2
        spans = [
            ((right + 0.001, left - 0.001), (low + 0.001, middle + half)),
            ((right + 0.001, left - 0.001), (middle - half, high - 0.001)),
        ]
        ways, travel = ("up", "down"), (high - low) / 2 - RAIL
    sashes = []
    for k in range(2):
        (y, z), plane, way = spans[k], planes[k], ways[k]
        leaf = sash(f"sash_{k + 1}", y, z, plane)
        if opens == "hung" and k:  # the upper sash is fast
            window.fixed("upper", frame, leaf)
        else:
            slide = f"slide_{k + 1}"
            window.prismatic(slide, frame, leaf, axis=way, range=(0, travel), friction=10)
        sashes.append(leaf)
    front = spans[0]
    latch = window.part("latch", material="brass")
    spot = (planes[0] + 0.0008, (front[0][0] + front[0][1]) / 2, front[1][1] - half)
    if opens == "sliding":
        spot = (planes[0] + 0.0008, front[0][1] - half, (low + high) / 2)
    latch.add(cylinder(0.014, x + OUT - spot[0]), at=spot, rpy=(0, math.pi / 2, 0), by="back")
    latch.add(box((0.012, 0.016, 0.07)), at=(x + OUT, spot[1], spot[2] - 0.012), by="front.bottom")
    window.revolute(
        "latch_turn", sashes[0], latch, at=spot, axis="front", range=(0, 1.57), friction=0.15
    )
