# Label: open test tube rack
from neoworld_mjx.program.sdk import Object, box, grid, panel

depth = 0.09  # 0.05 to 0.12 m
width = 0.24  # 0.05 to 0.3 m
height = 0.085  # 0.06 to 0.11 m
columns = 5  # 1 to 6
rows = 2  # 1 to 2
hole = 0.0115  # 0.009 to 0.018 m
finish = "pine"  # one of pine, acrylic, white

LOOK = {"pine": (0.8, 0.64, 0.42), "acrylic": (0.55, 0.7, 0.8), "white": (0.92, 0.92, 0.9)}
WALL, BOARD = 0.008, 0.006
obj = Object("tube_rack", label="open test tube rack")
stuff = obj.material("board", like="oak" if finish == "pine" else "pvc", rgb=LOOK[finish])
rack = obj.part("rack", material=stuff)
inner = width - 2 * WALL
places = grid((rows, columns), (depth / rows, inner / columns))
hole = min(hole, 0.42 * depth / rows, 0.42 * inner / columns)
rack.add(box((depth, width, 0.012)), by="bottom")
for z in (0.5 * height, height):
    holes = [(x, y, hole) for x, y, _ in places]
    rack.add(panel((depth, inner + 0.002), BOARD, holes=holes), at=(0, 0, z), by="top")
for side in (-1, 1):
    rack.add(box((depth, WALL, height)), at=(0, side * (width - WALL) / 2, 0), by="bottom")
