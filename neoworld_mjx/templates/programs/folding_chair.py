# Label: folding chair
# PartNet-Mobility: FoldingChair
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, sweep

depth = 0.5  # 0.44 to 0.56 m
width = 0.45  # 0.4 to 0.54 m
height = 0.8  # 0.74 to 0.92 m
seat = "slats"  # one of slats, board, padded
frame = "round"  # one of round, flat
finish = "grey"  # one of grey, white, oak, walnut

BAR, LEVEL = 0.011, 0.43  # half a rail; where the seat is
across = (math.pi / 2, 0, 0)
chair = Object("folding_chair", label="folding chair")
wooden = finish in ("oak", "walnut")
shade = {"grey": (0.4, 0.42, 0.45), "white": (0.92, 0.92, 0.9)}
if wooden:
    chair.material("rail", like=finish)
else:
    chair.material("rail", like="aluminium", rgb=shade[finish])
chair.material("plank", like="upholstery" if seat == "padded" else "oak" if not wooden else finish)


def rails(part, start, end, y):
    """Add rails between two points (x, z), at -y and y, with rubber feet at the start."""
    for side in (-y, y):
        line = [(start[0], side, start[1]), (end[0], side, end[1])]
        part.add(
            sweep(line, radius=BAR)
            if frame == "round"
            else sweep(line, width=2 * BAR, thickness=0.026)
        )
        part.add(
            box((0.032, 2 * BAR, 0.016)), at=(start[0], side, 0), by="bottom", material="rubber"
        )


# The long frame rises from the front foot to the back, the short one from the rear to the seat.
foot, tip = (depth / 2 - 0.016, 0.012), (-depth / 2 + 0.02, height - 0.012)
lean = math.atan2(foot[0] - tip[0], tip[1] - foot[1])


def along(z, out=0.0):
    """Return the point at height z of the long frame's rails, shifted to their front by out."""
    x = foot[0] - (z - foot[1]) * math.tan(lean)
    return x + out * math.cos(lean), z + out * math.sin(lean)


outer = width / 2 - BAR
main = chair.part("front_frame", material="rail")
rails(main, foot, tip, outer)
for k in range(2 if seat == "slats" else 1):
    z, tall = (height - 0.06 - 0.075 * k, 0.055) if seat == "slats" else (height - 0.09, 0.14)
    px, pz = along(z)
    main.add(
        box((0.014, width - 2 * BAR, tall)), at=(px, 0, pz), rpy=(0, -lean, 0), material="plank"
    )
px, pz = along(0.13)
main.add(cylinder(0.009, 2 * outer), at=(px, 0, pz), rpy=across)

inner = outer - 2 * BAR - 0.0004
start, end = (-depth / 2 + 0.016, 0.012), (depth / 2 - 0.06, LEVEL - 0.03)
slope = (end[0] - start[0]) / (end[1] - start[1])
rise = (foot[0] - start[0]) / (slope + math.tan(lean))
pivot = (start[0] + slope * rise, start[1] + rise)  # where the frames cross
legs = chair.part("rear_frame", material="rail")
rails(legs, start, end, inner)
for z in (0.12, end[1]):
    legs.add(cylinder(0.009, 2 * inner), at=(start[0] + slope * (z - 0.012), 0, z), rpy=across)
for side in (-inner, inner):
    legs.add(cylinder(0.006, 2 * BAR + 0.001), at=(pivot[0], side, pivot[1]), rpy=across)
fold = chair.revolute(
    "fold", main, legs, at=(pivot[0], 0, pivot[1]), axis=(0, -1, 0), range=(0, 0.5), friction=2.0
)

# The seat turns about a rod of the long frame, and rises as the legs close.
board = chair.part("seat", material="plank")
hinge = along(LEVEL)
main.add(cylinder(0.006, 2 * outer), at=(hinge[0], 0, hinge[1]), rpy=across, material="steel")
near, wide = hinge[0] - 0.06, 2 * inner - 2 * BAR - 0.006
span = depth / 2 - near
thick = 0.035 if seat == "padded" else 0.016
top = LEVEL + 0.008 + thick
for side in (-wide / 2 + 0.02, wide / 2 - 0.02):
    board.add(
        box((span - 0.01, 0.02, 0.012)),
        at=(near, side, LEVEL + 0.0075),
        by="back.bottom",
        material="rail",
    )
if seat == "slats":
    for k in range(6):
        board.add(
            box((0.13 * span, wide, 0.014)),
            at=(near + (k + 0.07) * span / 6, 0, LEVEL + 0.018),
            by="back.bottom",
        )
else:
    board.add(box((span, wide, thick)), at=(near, 0, LEVEL + 0.018), by="back.bottom")
chair.revolute(
    "seat_fold",
    main,
    board,
    at=(hinge[0], 0, hinge[1]),
    axis=(0, -1, 0),
    range=(0, 0.8),
    mimic=fold,
    multiplier=1.6,
    friction=4.0,
    opens="up",
)
