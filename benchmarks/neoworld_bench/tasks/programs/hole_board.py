# Label: board with holes
from neoworld_mjx.program.sdk import Object, box, grid, panel

depth = 0.12  # 0.05 to 0.3 m
width = 0.12  # 0.05 to 0.3 m
height = 0.05  # 0.02 to 0.12 m
columns = 1  # 1 to 4
rows = 1  # 1 to 2
form = "round"  # one of round, square, slot
hole = 0.034  # 0.01 to 0.16 m
slot = 0.01  # 0.003 to 0.03 m
wood = "oak"  # one of oak, walnut, pine

FLOOR = 0.006
obj = Object("hole_board", label="board with holes")
board = obj.part("board", material=wood)
# What does not fit its cell is made smaller.
cell = (depth / rows, width / columns)
hole = min(hole, 0.85 * cell[1], 1 if form == "slot" else 0.85 * cell[0])
slot = min(slot, 0.6 * cell[0])
holes = []
for x, y, _ in grid((rows, columns), cell):
    if form == "round":
        holes.append((x, y, hole / 2))
    elif form == "square":
        holes.append((x, y, hole, hole))
    else:
        holes.append((x, y, slot, hole))
board.add(box((depth, width, FLOOR)), by="bottom")
board.add(panel((depth, width), height - FLOOR, holes=holes), at=(0, 0, FLOOR), by="bottom")
