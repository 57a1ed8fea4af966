# Label: test tube rack with a lid

from neoworld_mjx.program.sdk import Object, box, cylinder, grid, panel, tube

depth = 0.1  # 0.08 to 0.14 m
width = 0.24  # 0.16 to 0.32 m
height = 0.11  # 0.09 to 0.14 m
columns = 6  # 4 to 7
rows = 2  # 1 to 2
tubes = 3  # 1 to 5
finish = "pine"  # one of pine, acrylic, white
sides = "cheeks"  # one of cheeks, posts

LOOK = {"pine": (0.8, 0.64, 0.42), "acrylic": (0.7, 0.82, 0.88), "white": (0.92, 0.92, 0.9)}
WALL, BOARD, LID = 0.008, 0.006, 0.004
obj = Object("test_tube_rack", label="test tube rack with a lid")
stuff = obj.material("board", like="pine" if finish == "pine" else "acrylic", rgb=LOOK[finish])
clear = obj.material("clear", like="glass", rgb=(0.82, 0.9, 0.92), alpha=0.5)
rack = obj.part("rack", material=stuff)
inner = width - 2 * WALL
deep = depth - 0.012
step = (deep / rows, inner / columns)
hole = 0.4 * min(step)
places = grid((rows, columns), step)
shelf_z = 0.62 * height
rack.add(box((deep, width, BOARD)), by="bottom")
holes = [(x, y, hole) for x, y, _ in places]
rack.add(panel((deep, inner + 0.002), BOARD, holes=holes, sectors=8), at=(0, 0, shelf_z))
top = height - LID - 0.0005
for y in (-width / 2, width / 2):
    face = "left" if y > 0 else "right"
    if sides == "cheeks":
        rack.add(box((deep, WALL, top)), at=(0, y, 0), by=f"{face}.bottom")
    else:
        for x in (-deep / 2, deep / 2):
            edge = "front" if x > 0 else "back"
            rack.add(box((0.014, WALL, top)), at=(x, y, 0), by=f"{face}.bottom.{edge}")
lid = obj.part("lid", material=clear)
lid.add(box((deep, width, LID)), at=(0, 0, height), by="top")
lid.add(box((0.006, 0.05, 0.02)), at=(deep / 2 + 0.006, 0, height), by="front.top", material=stuff)
lid.add(box((0.006, 0.03, LID)), at=(-deep / 2, 0, height), by="front.top", material=stuff)
hinge = (-deep / 2, 0, height - LID)
obj.revolute("lid_hinge", rack, lid, at=hinge, axis=(0, -1, 0), range=(0, 1.9), friction=0.04)

# Tubes stand in the holes and are drawn out upwards once the lid is open.
long, r = top - BOARD - 0.002, min(hole - 0.0012, 0.009)
for k in range(tubes):
    x, y, _ = places[(k * 5 + 1) % len(places)]
    glass = obj.part(f"tube_{k + 1}", material=clear)
    low = BOARD + 0.0005
    glass.add(tube(r, 0.0012, long - r), at=(x, y, low + r - 0.001), by="bottom")
    glass.add(
        cylinder(0.8 * r, r),
        at=(x, y, low),
        by="bottom",
        rgb=[(0.8, 0.3, 0.2), (0.3, 0.5, 0.8), (0.9, 0.8, 0.3)][k % 3],
    )
    obj.prismatic(
        f"draw_{k + 1}", rack, glass, axis="top", range=(0, 0.8 * height), friction=0.3, after=lid
    )
