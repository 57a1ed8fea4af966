# Label: plank
from neoworld_mjx.program.sdk import Object, box

depth = 0.03  # 0.01 to 0.1 m
width = 0.14  # 0.03 to 0.5 m
height = 1.0  # 0.2 to 2.0 m
wood = "pine"  # one of pine, oak, walnut, plywood

plank = Object("plank", label="plank")
plank.part("body", material=wood).add(box((depth, width, height)), by="bottom")
