# Label: wardrobe
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, mirror

depth = 0.6  # 0.45 to 0.7 m
width = 1.2  # 0.8 to 2.0 m
height = 2.0  # 1.7 to 2.3 m
doors = 2  # 2 to 4
drawers = 2  # 1 to 3
fronts = "hinged"  # one of hinged, sliding
feet = "legs"  # one of legs, plinth
wood = "oak"  # one of oak, pine, walnut, chipboard

LEAF, PULL, WALL, FOOT, CHEST = 0.018, 0.03, 0.02, 0.08, 0.28
thick = LEAF + PULL if fronts == "hinged" else 2 * LEAF + PULL
deep, x = depth - thick, depth / 2 - thick
obj = Object("wardrobe", label="wardrobe")
body = obj.part("body", material=wood)
shell = hollow_box((deep, width, height - FOOT), WALL, open="+x")
body.add(shell, at=(x, 0, FOOT), by="front.bottom")
obj.shelf(body, x=(x - deep + WALL, x), y=(-width / 2 + WALL, width / 2 - WALL), z=FOOT + CHEST)
if feet == "plinth":
    body.add(box((deep - 0.04, width - 0.04, FOOT)), at=(x - 0.02, 0, FOOT), by="front.top")
else:
    for y in (-width / 2 + 0.05, width / 2 - 0.05):
        for fx in (x - 0.05, x - deep + 0.05):
            body.add(cylinder(0.025, FOOT), at=(fx, y, FOOT), by="top", material="steel")
rod = cylinder(0.014, width - 2 * WALL)
body.add(rod, at=(x - deep / 2, 0, height - 0.14), rpy=(math.pi / 2, 0, 0), material="steel")

cell = (width - 2 * WALL) / drawers
for k in range(drawers):
    low = -width / 2 + WALL + k * cell
    if k:
        board = box((deep - WALL, WALL, CHEST - WALL))
        body.add(board, at=(x, low, FOOT + WALL), by="front.bottom")
    sides = (low + (WALL / 2 if k else 0), low + cell - (WALL / 2 if k < drawers - 1 else 0))
    chest = obj.drawer(
        f"drawer_{k + 1}",
        body,
        x=x,
        y=sides,
        z=(FOOT + WALL, FOOT + CHEST - 0.018),
        depth=deep - WALL - 0.02,
        overlay=0.008,
    )
    middle = (chest.anchor("front")[0] - 0.003, (sides[0] + sides[1]) / 2, FOOT + 0.75 * CHEST)
    chest.add(box((PULL + 0.003, 0.14, 0.015)), at=middle, by="back", material="steel")

leaf, low, high = width / doors, FOOT + CHEST, height
if fronts == "sliding":
    low, high = low + 0.02, height - 0.03
    for z in (low - 0.001, height):
        rail = box((2 * LEAF + 0.004, width, 0.02 if z < high else 0.029))
        body.add(rail, at=(x, 0, z), by="back.top")
for k in range(doors):
    door = obj.part(f"door_{k + 1}", material=wood)
    y = -width / 2 + (k + 0.5) * leaf
    plane = x + 0.0005 + (k % 2 * (LEAF + 0.001) if fronts == "sliding" else 0)
    lap = 0.01 if fronts == "sliding" and 0 < k < doors - 1 else -0.002
    panel = box((LEAF, leaf + lap, high - low - 0.003))
    door.add(panel, at=(plane, y, low + 0.001), by="back.bottom")
    left = k % 2 == 1 or k == doors - 1
    if fronts == "hinged":
        side = "left" if left else "right"
        pivot, axis = door.anchor(f"{side}.front"), (0, 0, 1 if left else -1)
        # A leaf that opens towards its neighbour stops before the two handles meet.
        far = 1.55 if k in (0, doors - 1) else 1.25
        obj.revolute(f"hinge_{k + 1}", body, door, at=pivot, axis=axis, range=(0, far))
        grip = y + (leaf / 2 - 0.05) * (-1 if left else 1)
        for z in mirror((0, 0, 0.1), "z"):
            post = box((PULL - 0.008, 0.012, 0.012))
            door.add(post, at=(plane + LEAF, grip, 1.1 + z[2]), by="back", material="steel")
        bar = cylinder(0.008, 0.26)
        door.add(bar, at=(x + thick, grip, 1.1), by="front", material="steel")
    else:
        # Each plane holds every other leaf, which leaves a gap of one leaf to slide into.
        travel = 0.9 * leaf if doors == 2 else 0.42 * leaf
        way = "left" if k < doors / 2 else "right"
        obj.prismatic(f"slide_{k + 1}", body, door, axis=way, range=(0, travel))
        strip = box((0.004, 0.03, 0.8 * (high - low)))
        end = y + (leaf / 2 - 0.04) * (-1 if way == "left" else 1)
        if k % 2:
            door.add(
                strip, at=(plane + LEAF, end, (low + high) / 2), by="back", rgb=(0.3, 0.3, 0.3)
            )
