# Label: open shelf
from neoworld_mjx.program.sdk import Object, box

depth = 0.28  # 0.15 to 0.6 m
width = 0.8  # 0.3 to 2.0 m
height = 0.8  # 0.2 to 2.0 m
boards = 3  # 2 to 6
wood = "oak"  # one of oak, pine, walnut, white

shelf = Object("shelf_unit", label="open shelf")
like = "mdf" if wood == "white" else wood
look = {"rgb": (0.9, 0.9, 0.88), "pattern": "plain"} if wood == "white" else {}
stuff = shelf.material("stuff", like=like, **look)
body = shelf.part("body", material=stuff)
T = 0.02
for side, y in (("left", width / 2), ("right", -width / 2)):
    body.add(box((depth, T, height)), at=(0, y, 0), by=f"{side}.bottom")
body.add(box((0.008, width, height)), at=(-depth / 2, 0, 0), by="back.bottom")
for k in range(boards):
    z = T + k * (height - T) / (boards - 1)
    body.add(box((depth, width, T)), at=(0, 0, z), by="top")
