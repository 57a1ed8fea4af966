# Label: open test tube rack
from neoworld_mjx.program.sdk import Object, box, grid, panel

depth = 0.08  # 0.05 to 0.2 m
width = 0.24  # 0.1 to 0.5 m
height = 0.08  # 0.05 to 0.2 m
columns = 5  # 2 to 8
rows = 1  # 1 to 3
bore = 0.024  # 0.014 to 0.05 m
wood = "pine"  # one of pine, bamboo, oak, white

rack = Object("tube_stand", label="open test tube rack")
like = "plastic" if wood == "white" else wood
stuff = rack.material("stuff", like=like, **({"rgb": (0.9, 0.9, 0.88)} if wood == "white" else {}))
body = rack.part("body", material=stuff)
BOARD, WALL = 0.006, 0.008
body.add(box((depth, width, BOARD)), by="bottom")
for side, y in (("left", width / 2), ("right", -width / 2)):
    body.add(box((depth, WALL, height)), at=(0, y, 0), by=f"{side}.bottom")
step = (depth / rows, (width - 2 * WALL) / columns)
holes = [(x, y, bore / 2) for x, y, _ in grid((rows, columns), step)]
for z in (0.55 * height, height - BOARD / 2):
    body.add(panel((depth, width - 2 * WALL + 0.002), BOARD, holes=holes, sectors=8), at=(0, 0, z))
