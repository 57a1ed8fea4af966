# Label: suitcase on wheels
# PartNet-Mobility: Suitcase
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, mirror, rounded_box, tube

depth = 0.27  # 0.22 to 0.34 m
width = 0.44  # 0.36 to 0.54 m
height = 0.7  # 0.56 to 0.8 m
dials = 3  # 3 to 4
shell = "ribbed"  # one of ribbed, strapped, corners
colour = "teal"  # one of teal, red, grey, black, yellow

WALL, OUT, LIFT, GRIP, WHEEL, RAIL = 0.003, 0.01, 0.06, 0.03, 0.022, 0.018
case = Object("suitcase", label="suitcase on wheels")
shade = {
    "teal": (0.1, 0.45, 0.48),
    "red": (0.65, 0.13, 0.15),
    "grey": (0.5, 0.52, 0.55),
    "black": (0.13, 0.13, 0.14),
    "yellow": (0.88, 0.68, 0.15),
}
case.material("hard", like="abs", rgb=shade[colour])
case.material("dark", like="nylon", rgb=(0.12, 0.12, 0.13))
body = case.part("body", material="hard")
back, half = -depth / 2 + RAIL, width / 2 - OUT
deep, front = 0.8 * (depth - OUT - RAIL), 0.2 * (depth - OUT - RAIL) - 0.001
tall = height - GRIP - LIFT
x = back + deep
body.add(hollow_box((deep, 2 * half, tall), WALL, open="+x"), at=(back, 0, LIFT), by="back.bottom")
lid = case.part("lid", material="hard")
lid.add(
    hollow_box((front, 2 * half, tall), WALL, open="-x"), at=(x + 0.001, 0, LIFT), by="back.bottom"
)
middle = LIFT + tall / 2
case.revolute(
    "lid_hinge",
    body,
    lid,
    at=(x + 0.0005, half, middle),
    axis=(0, 0, 1),
    range=(0, 1.57),
    opens="front",
)
face = x + 0.001 + front
for k in range(6 if shell == "ribbed" else 2):
    y, wide = (
        ((k - 2.5) * 0.15 * width, 0.06 * width)
        if shell == "ribbed"
        else ((k - 0.5) * 0.5 * width, 0.09 * width)
    )
    if shell == "corners":
        for z in (LIFT + 0.04, LIFT + tall - 0.04):
            at = (face + OUT, (2 * k - 1) * half, z)
            lid.add(
                rounded_box((0.05, 0.09, 0.08), 0.01),
                at=at,
                by="front.left" if k else "front.right",
                material="dark",
            )
        continue
    strap = (0.35, 0.22, 0.12) if shell == "strapped" else shade[colour]
    lid.add(
        box((OUT + 0.002, wide, 0.9 * tall)), at=(face - 0.002, y, middle), by="back", rgb=strap
    )
# Feet at one side, a lock with dials at the other, a handle to carry at the side of the lock.
for z in (-0.3, 0.3):
    body.add(
        cylinder(0.012, OUT + 0.002),
        at=(x - 0.06, half - 0.002, middle + z * tall),
        rpy=(math.pi / 2, 0, 0),
        by="right",
        material="dark",
    )
    body.add(
        box((0.025, 0.003, 0.02)),
        at=(back + 0.4 * deep, -half + 0.001, middle + z * 0.3 * tall),
        by="left",
        material="dark",
    )
carry = case.part("side_handle", material="dark")
carry.add(
    box((0.025, 0.006, 0.2 * tall)), at=(back + 0.4 * deep, -half - 0.0027, middle), by="left"
)
case.revolute(
    "carry_fold",
    body,
    carry,
    at=(back + 0.4 * deep - 0.0125, -half - 0.006, middle),
    axis=(0, 0, -1),
    range=(0, 1.4),
    friction=0.5,
    damping=0.02,
)
lock = body.add(
    box((0.03, 0.006, 0.06 + 0.014 * dials)),
    at=(x - 0.02, -half + 0.002, middle),
    by="front.left",
    material="dark",
)
for k in range(dials):
    dial = case.part(f"dial_{k + 1}", material="brass")
    at = (x - 0.035, lock.anchor("right")[1] - 0.0008, middle + (k - (dials - 1) / 2) * 0.014)
    dial.add(cylinder(0.0055, 0.003), at=at, rpy=(math.pi / 2, 0, 0), by="left")
    dial.add(
        box((0.001, 0.001, 0.005)),
        at=(at[0], at[1] - 0.003, at[2]),
        by="bottom",
        rgb=(0.1, 0.1, 0.1),
        role="visual",
    )
    case.continuous(f"dial_turn_{k + 1}", body, dial, at=at, axis="right")

# The pulling handle runs outside on the back: tubes slide on the shell, rods in the tubes.
y, rod, top = 0.17 * width, -depth / 2 + RAIL / 2, height - GRIP
run = 0.62 * tall
tubes = case.part("tubes", material="aluminium")
pull = case.part("handle", material="dark")
for side in mirror((rod, y, top)):
    tubes.add(tube(RAIL / 2 - 0.001, 0.002, run, sectors=16), at=side, by="top")
    rods = cylinder(RAIL / 2 - 0.0042, run - 0.01)
    pull.add(rods, at=(side[0], side[1], top + 0.004), by="top", material="aluminium")
    body.add(
        box((RAIL, 0.03, 0.008)),
        at=(back, side[1], top - run - 0.001),
        by="front.top",
        material="dark",
    )
pull.add(rounded_box((RAIL, 2 * y + 0.03, GRIP - 0.0008), 0.006), at=(rod, 0, height), by="top")
tubes.add(box((0.006, 2 * y - RAIL + 0.004, 0.02)), at=(rod, 0, top - 0.01))
case.prismatic("tubes_slide", body, tubes, axis="up", range=(0, 0.6 * run), friction=8)
case.prismatic("handle_slide", tubes, pull, axis="up", range=(0, 0.7 * run), friction=8)

# Four wheels, each in a fork that swivels under a corner.
for k, (wx, wy) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1))):
    at = (back + deep / 2 + wx * (deep / 2 - 0.03), wy * (half - 0.045))
    fork = case.part(f"fork_{k + 1}", material="dark")
    fork.add(cylinder(0.018, LIFT - 0.0006 - 2 * WHEEL - 0.002), at=(*at, LIFT - 0.0006), by="top")
    for side in (-1, 1):
        cheek = (at[0] - 0.008, at[1] + side * 0.012, LIFT - 0.008)
        fork.add(box((0.022, 0.004, 0.042)), at=cheek, by="top")
    case.continuous(f"swivel_{k + 1}", body, fork, at=(*at, LIFT - 0.01), axis="up")
    wheel = case.part(f"wheel_{k + 1}", material="rubber")
    hub = (at[0] - 0.008, at[1], WHEEL)
    wheel.add(cylinder(WHEEL, 0.018), at=hub, rpy=(math.pi / 2, 0, 0))
    case.continuous(f"roll_{k + 1}", fork, wheel, at=hub, axis="left", friction=0.02)
