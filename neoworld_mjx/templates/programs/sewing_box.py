# Label: sewing box with two lids, a tray and a drawer
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, mirror, sphere

depth = 0.24  # 0.2 to 0.3 m
width = 0.36  # 0.3 to 0.46 m
height = 0.22  # 0.19 to 0.28 m
cells = 3  # 1 to 4
spools = 3  # 1 to 4
wood = "pine"  # one of pine, oak, walnut
lining = "red"  # one of red, green, cream

TINT = {"red": (0.62, 0.14, 0.16), "green": (0.2, 0.4, 0.28), "cream": (0.9, 0.86, 0.74)}
THREAD = ((0.75, 0.2, 0.25), (0.2, 0.35, 0.65), (0.9, 0.75, 0.25), (0.25, 0.55, 0.35))
WALL, FRONT, KNOB, LID, FOOT, PULL = 0.008, 0.012, 0.014, 0.008, 0.012, 0.013
obj = Object("sewing_box", label="sewing box with two lids, a tray and a drawer")
cloth = obj.material("lining", like="fabric", rgb=TINT[lining])
deep = depth - FRONT - KNOB
back, x = -depth / 2, -depth / 2 + deep
middle = back + deep / 2
rim = height - PULL - LID - 0.0005
cell = 0.3 * rim

# Below an opening for the drawer, above an open box under the two lids.
body = obj.part("body", material=wood)
lower = hollow_box((deep, width, cell + WALL), WALL, open="+x")
body.add(lower, at=(back, 0, FOOT), by="back.bottom")
upper = hollow_box((deep, width, rim - FOOT - cell), WALL)
body.add(upper, at=(back, 0, rim), by="back.top")
for px, py, _ in mirror(mirror((0.4 * deep, 0.44 * width, 0)), "x"):
    body.add(box((0.024, 0.024, FOOT + 0.001)), at=(middle + px, py, 0), by="bottom")

drawer = obj.drawer(
    "drawer",
    body,
    x=x,
    y=(-width / 2 + WALL, width / 2 - WALL),
    z=(FOOT + WALL, FOOT + cell),
    depth=deep - WALL - 0.006,
    wall=0.004,
    front=FRONT,
    overlay=WALL - 0.002,
)
stem = (x + FRONT - 0.002, 0, FOOT + WALL / 2 + cell / 2)
drawer.add(cylinder(0.003, KNOB), at=stem, rpy=(0, math.pi / 2, 0), by="back", material="brass")
drawer.add(sphere(0.005), at=(depth / 2, 0, stem[2]), by="front", material="brass")

lids = []
for sign, side in ((1, "left"), (-1, "right")):
    lid = obj.part(f"{side}_lid", material=wood)
    panel = box((deep, width / 2 - 0.0005, LID))
    lid.add(panel, at=(middle, sign * width / 2, rim + 0.0005), by=f"{side}.bottom")
    pull = (middle, sign * 0.03, rim + LID)
    lid.add(cylinder(0.004, PULL), at=(*pull[:2], height), by="top", material="brass")
    lid.add(sphere(0.006), at=(*pull[:2], height), by="top", material="brass")
    hinge = (middle, sign * width / 2, rim + 0.0005)
    obj.revolute(
        f"{side}_lid_hinge", body, lid, at=hinge, axis=(-sign, 0, 0), range=(0, 1.9), friction=0.3
    )
    lids.append(lid)

# The tray hangs in the upper box on two ledges, and lifts out once both lids are open.
inside = (deep - 2 * WALL - 0.002, width - 2 * WALL - 0.002)
tall = 0.4 * (rim - FOOT - cell)
floor = rim - 0.004 - tall
for y in (-width / 2 + WALL - 0.001, width / 2 - WALL + 0.001):
    face = "left" if y > 0 else "right"
    body.add(box((inside[0], 0.009, 0.006)), at=(middle, y, floor - 0.0006), by=f"{face}.top")
tray = obj.part("tray", material=wood)
tray.add(hollow_box((*inside, tall), 0.003), at=(middle, 0, floor), by="bottom")
for k in range(1, cells):
    y = k * inside[1] / cells - inside[1] / 2
    tray.add(
        box((inside[0] - 0.004, 0.003, tall - 0.004)), at=(middle, y, floor + 0.002), by="bottom"
    )
obj.prismatic("tray_lift", body, tray, axis="up", range=(0, 0.1), after=lids, friction=12.0)
# Spools stand on pins in the tray and turn.
size = min(0.012, 0.3 * tall)
for k in range(spools):
    y = ((k + 0.5) / spools - 0.5) * 0.8 * inside[1] + 0.006
    place = (middle - 0.28 * inside[0], y, floor + 0.0036)
    if any(
        abs(y - (j * inside[1] / cells - inside[1] / 2)) < size + 0.004 for j in range(1, cells)
    ):
        continue
    spool = obj.part(f"spool_{k + 1}", material="wood")
    spool.add(cylinder(size, tall - 0.006), at=place, by="bottom", rgb=THREAD[k % 4])
    obj.continuous(f"spool_turn_{k + 1}", tray, spool, at=place, axis="up", friction=0.001)
