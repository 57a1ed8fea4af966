# Label: board
from neoworld_mjx.program.sdk import Object, box

depth = 0.3  # 0.02 to 1.5 m
width = 0.1  # 0.02 to 1.0 m
height = 0.015  # 0.004 to 0.08 m
wood = "pine"  # one of pine, oak, walnut, plywood, mdf, bamboo, cork

board = Object("board", label="board")
board.part("body", material=wood).add(box((depth, width, height)), by="bottom")
