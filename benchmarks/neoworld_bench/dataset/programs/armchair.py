# Label: armchair
from neoworld_mjx.program.sdk import Object, box

depth = 0.6  # 0.45 to 0.9 m
width = 0.66  # 0.5 to 0.9 m
height = 0.8  # 0.6 to 1.1 m
wood = "oak"  # one of oak, pine, walnut

chair = Object("armchair", label="armchair")
body = chair.part("body", material=wood)
POST, SEAT = 0.05, 0.42 * height
body.add(box((depth, width, 0.03)), at=(0, 0, SEAT), by="top")
body.add(box((0.03, width, height - SEAT)), at=(-depth / 2, 0, SEAT), by="back.bottom")
for y, side in ((-1, "right"), (1, "left")):
    edge = y * width / 2
    for x, end in ((-1, "back"), (1, "front")):
        leg = box((POST, POST, SEAT - 0.03))
        body.add(leg, at=(x * depth / 2, edge, 0), by=f"{end}.{side}.bottom")
    body.add(box((depth, POST, 0.22)), at=(0, edge, SEAT), by=f"{side}.bottom")
