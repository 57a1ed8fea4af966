# Label: office chair
# PartNet-Mobility: Chair
import math

from neoworld_mjx.program.sdk import (
    Object,
    box,
    cylinder,
    mirror,
    panel,
    ring,
    rounded_box,
    sweep,
    tube,
)  # fmt: skip

depth = 0.64  # 0.6 to 0.72 m
width = 0.64  # 0.6 to 0.72 m
height = 1.1  # 0.95 to 1.3 m
back = "mesh"  # one of mesh, padded, executive
arms = "yes"  # one of yes, no
colour = "black"  # one of black, blue, red, grey

WHEEL = 0.027
chair = Object("office_chair", label="office chair")
shade = {
    "black": (0.12, 0.12, 0.13),
    "blue": (0.15, 0.25, 0.45),
    "red": (0.55, 0.12, 0.12),
    "grey": (0.5, 0.5, 0.5),
}
chair.material("cloth", like="upholstery", rgb=shade[colour])
chair.material("dark", like="nylon", rgb=(0.13, 0.13, 0.14))
base = chair.part("base", material="dark")
reach = min(depth, width) / 2 - 0.05
base.add(tube(0.03, 0.011, 0.2, sectors=16), at=(0, 0, 0.07), by="bottom", name="hub")
base.add(cylinder(0.03, 0.012), at=(0, 0, 0.07), by="bottom")
for k, (px, py, _) in enumerate(ring(5, reach)):
    a = 2 * math.pi * k / 5
    c, s = px / reach, py / reach
    leg = [(0.022 * c, 0.022 * s, 0.105), (0.5 * px, 0.5 * py, 0.095), (px, py, 0.08)]
    base.add(
        sweep(leg, width=[0.05, 0.045, 0.035], thickness=[0.04, 0.03, 0.022]), name=f"leg_{k + 1}"
    )
    # A caster swivels about the leg's tip; its wheel trails behind.
    fork = chair.part(f"fork_{k + 1}", material="dark")
    fork.add(cylinder(0.008, 0.012), at=(px, py, 0.0685), by="top")
    at = (px - 0.012 * c, py - 0.012 * s)
    fork.add(box((0.036, 0.034, 0.006)), at=(at[0], at[1], 0.0565), rpy=(0, 0, a), by="bottom")
    for side in (-0.0145, 0.0145):
        cheek = (at[0] - side * s, at[1] + side * c, 0.0575)
        fork.add(box((0.03, 0.005, 0.036)), at=cheek, rpy=(0, 0, a), by="top")
    chair.continuous(f"swivel_{k + 1}", base, fork, at=(px, py, 0.06), axis="up")
    wheel = chair.part(f"wheel_{k + 1}", material="nylon")
    wheel.add(
        cylinder(WHEEL, 0.022), at=(*at, WHEEL), rpy=(math.pi / 2, 0, a), rgb=(0.25, 0.25, 0.26)
    )
    chair.continuous(f"roll_{k + 1}", fork, wheel, at=(*at, WHEEL), axis=(-s, c, 0), friction=0.02)

seat_z = 0.45
column = chair.part("column", material="steel", mass=1.2)
column.add(cylinder(0.0172, seat_z - 0.165), at=(0, 0, 0.0835), by="bottom")
chair.prismatic("lift", base, column, axis="up", range=(0, 0.09), damping=900)
seat = chair.part("seat", material="cloth")
rear = -depth / 2
deep, wide = depth - 0.13, min(0.5, width - 0.13)
mid = depth / 2 - deep / 2
gear = seat.add(box((0.2, 0.14, 0.04)), at=(0, 0, seat_z - 0.08), by="bottom", material="dark")
cushion = seat.add(rounded_box((deep, wide, 0.07), 0.03), at=(mid, 0, seat_z - 0.045), by="bottom")
chair.continuous("turn", column, seat, at=(0, 0, seat_z), axis="up")
lever = chair.part("lever", material="dark")
lever.add(
    cylinder(0.006, 0.15), at=(0.085, -0.071, seat_z - 0.072), rpy=(math.pi / 2, 0, 0), by="left"
)
lever.add(box((0.03, 0.05, 0.008)), at=(0.085, -0.2, seat_z - 0.072), by="right")
chair.revolute(
    "lever_pull",
    seat,
    lever,
    at=(0.085, -0.071, seat_z - 0.072),
    axis=(-1, 0, 0),
    range=(0, 0.08),
    friction=0.3,
)

# The back leans on a bracket behind the seat.
rest = chair.part("backrest", material="dark")
pivot = (mid - deep / 2 - 0.012, 0, seat_z - 0.062)
seat.add(
    box((pivot[0] * -1 - 0.006, 0.06, 0.02)),
    at=(pivot[0] + 0.0125, 0, pivot[2]),
    by="back",
    material="dark",
)
head = back == "executive"
top = height - (0.17 if head else 0)
low = seat_z + (0.04 if head else 0.13)
spine = [(pivot[0], 0, pivot[2]), (rear + 0.025, 0, seat_z), (rear + 0.02, 0, low + 0.25)]
rest.add(cylinder(0.012, 0.06), at=pivot, rpy=(math.pi / 2, 0, 0))
rest.add(sweep(spine, width=0.06, thickness=0.025, smooth=2), name="spine")
middle, tall = (rear + 0.055, 0, (low + top) / 2), top - low
if back == "mesh":
    rows = [(0, (k - 3) * tall / 8, 0.8 * wide, 0.6 * tall / 8) for k in range(7)]
    rest.add(panel((0.92 * wide, tall), 0.02, [(y, z, w, h) for y, z, w, h in rows]), at=middle,
             rpy=(math.pi / 2, 0, math.pi / 2), name="mesh")  # fmt: skip
    rest.add(box((0.005, 0.86 * wide, 0.95 * tall)), at=middle, material="cloth")
    rest.add(box((0.04, 0.05, 0.2)), at=(rear + 0.035, 0, low + 0.15))
else:
    rest.add(rounded_box((0.07, 0.94 * wide, tall), 0.03), at=middle, material="cloth")
rest.add(box((0.02, 0.04, 0.08)), at=(rear, 0, low + 0.12), by="back")
chair.revolute("recline", seat, rest, at=pivot, axis=(0, -1, 0), range=(0, 0.4), friction=25)
if head:
    pillow = chair.part("headrest", material="cloth")
    pillow.add(rounded_box((0.06, 0.28, 0.13), 0.025), at=(rear + 0.055, 0, height), by="top")
    for post in mirror((rear + 0.055, 0.06, top + 0.0008)):
        pillow.add(cylinder(0.006, 0.06), at=post, by="bottom", material="steel")
    chair.prismatic("headrest_lift", rest, pillow, axis="up", range=(0, 0.06), friction=15)
if arms == "yes":
    for sign, side in ((-1, "right"), (1, "left")):
        y = sign * (width / 2 - 0.03)
        inner = sign * (0.5 * wide - 0.05)
        bar = box((0.06, abs(y - inner) + 0.012, 0.016))
        seat.add(bar, at=(mid - 0.03, (y + inner) / 2, seat_z - 0.05), material="dark")
        seat.add(
            box((0.05, 0.02, 0.16)),
            at=(mid - 0.03, y, seat_z - 0.055),
            by="bottom",
            material="dark",
        )
        arm = chair.part(f"{side}_arm", material="dark")
        arm.add(box((0.035, 0.014, 0.13)), at=(mid - 0.03, y + sign * 0.011, seat_z + 0.21),
                by="right.top" if sign > 0 else "left.top")  # fmt: skip
        arm.add(
            rounded_box((0.25, 0.06, 0.03), 0.01), at=(mid - 0.02, y, seat_z + 0.2), by="bottom"
        )
        chair.prismatic(f"{side}_arm_lift", seat, arm, axis="up", range=(0, 0.07), friction=15)
else:
    # Without arms the seat has the chair's full width.
    seat.add(rounded_box((0.8 * deep, width, 0.05), 0.02), at=(mid, 0, seat_z - 0.04), by="bottom")
