# Label: stool
from neoworld_mjx.program.sdk import Object, box

depth = 0.36  # 0.2 to 1.0 m
width = 0.36  # 0.2 to 1.0 m
height = 0.45  # 0.2 to 0.8 m
wood = "oak"  # one of oak, pine, walnut

stool = Object("stool", label="stool")
body = stool.part("body", material=wood)
SEAT, LEG = 0.025, 0.035
body.add(box((depth, width, SEAT)), at=(0, 0, height), by="top")
for x in (-1, 1):
    for y in (-1, 1):
        at = (x * (depth - LEG) / 2, y * (width - LEG) / 2, 0)
        body.add(box((LEG, LEG, height - SEAT)), at=at, by="bottom")
